"""Feedback controllers on arrays; the policies that hold their gains are in `baselines.policies`."""

from baselines.control.pid import PID, PIDState

__all__ = ["PID", "PIDState"]
