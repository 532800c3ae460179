"""Kinematics: the arms' and the docking tool's poses from joints and joints from poses, and where they can reach."""

from baselines.kinematics.arm import Arm
from baselines.kinematics.dls import servo_step
from baselines.kinematics.docking_tool import DockingTool, ToolSolution, Unreachable
from baselines.kinematics.docking_workspace import SetPoint, Workspace, level_pose
from baselines.kinematics.ik import IKResult, solve_ik

__all__ = [
    "Arm",
    "DockingTool",
    "IKResult",
    "SetPoint",
    "ToolSolution",
    "Unreachable",
    "Workspace",
    "level_pose",
    "servo_step",
    "solve_ik",
]
