"""Kinematics of the docking tool: poses from joints, joints from poses, and where its readings are trustworthy."""

from baselines.kinematics.docking_tool import DockingTool, ToolSolution, Unreachable
from baselines.kinematics.docking_workspace import SetPoint, Workspace, level_pose

__all__ = ["DockingTool", "SetPoint", "ToolSolution", "Unreachable", "Workspace", "level_pose"]
