"""Kinematics: the arms' and the docking tool's poses from joints and joints from poses, and where they can reach."""

from baselines.kinematics.arm import Arm
from baselines.kinematics.closed_form_4dof import branches_4dof
from baselines.kinematics.closed_form_6dof import branches_6dof
from baselines.kinematics.dls import servo_step
from baselines.kinematics.docking_tool import DockingTool, ToolSolution, Unreachable
from baselines.kinematics.docking_workspace import SetPoint, Workspace, level_pose
from baselines.kinematics.ik import IKResult, solve_ik
from baselines.kinematics.manipulability import condition_number, manipulability
from baselines.kinematics.reachability import Reachability, approach_directions, reachability

__all__ = [
    "Arm",
    "DockingTool",
    "IKResult",
    "Reachability",
    "SetPoint",
    "ToolSolution",
    "Unreachable",
    "Workspace",
    "approach_directions",
    "branches_4dof",
    "branches_6dof",
    "condition_number",
    "level_pose",
    "manipulability",
    "reachability",
    "servo_step",
    "solve_ik",
]
