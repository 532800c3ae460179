"""The suite's ids, entry points (strings: nothing is imported until an environment is made) and reference policies."""

from __future__ import annotations

import difflib
import importlib
from typing import TYPE_CHECKING, Any

import gymnasium

if TYPE_CHECKING:
    from aerograsp_env.interfaces import Policy

EPISODE_STEPS: dict[str, int | None] = {  # at 50 Hz, where nothing else is said
    "aerograsp/Detect-v0": 40,  # at 10 Hz
    "aerograsp/Dock-v0": 3000,
    "aerograsp/DockAttach-v0": 3000,
    "aerograsp/DockManipulate-v0": 1500,
    "aerograsp/Grasp-v0": 1000,
    "aerograsp/GraspDual-v0": 1000,
    "aerograsp/GraspPlan-v0": None,  # ends by itself at the first step
    "aerograsp/Reach-v0": 500,
}

ENTRY_POINTS: dict[str, tuple[str, str | None]] = {  # of one world, and of a native batch where there is one
    "aerograsp/Detect-v0": ("aerograsp_env.envs.detect:DetectEnv", None),
    "aerograsp/Dock-v0": ("aerograsp_env.envs.dock:DockEnv", "aerograsp_env.vector:DockVectorEnv"),
    "aerograsp/DockAttach-v0": ("aerograsp_env.envs.dock:DockAttachEnv", "aerograsp_env.vector:DockAttachVectorEnv"),
    "aerograsp/Grasp-v0": ("aerograsp_env.envs.grasp:GraspEnv", "aerograsp_env.grasp_vector:GraspVectorEnv"),
    "aerograsp/DockManipulate-v0": (
        "aerograsp_env.envs.dock_manipulate:DockManipulateEnv",
        "aerograsp_env.manipulation_vector:DockManipulateVectorEnv",
    ),
    "aerograsp/GraspDual-v0": (
        "aerograsp_env.envs.grasp_dual:GraspDualEnv",
        "aerograsp_env.grasp_vector:GraspDualVectorEnv",
    ),
    "aerograsp/GraspPlan-v0": ("aerograsp_env.envs.grasp_plan:GraspPlanEnv", None),
    "aerograsp/Reach-v0": ("aerograsp_env.envs.reach:ReachEnv", "aerograsp_env.manipulation_vector:ReachVectorEnv"),
}

REFERENCE_POLICIES: dict[str, str] = {
    "aerograsp/Detect-v0": "baselines.policies.detect:clusters_icp",
    "aerograsp/Dock-v0": "baselines.policies.dock:pid",
    "aerograsp/DockAttach-v0": "baselines.policies.dock_attach:pid",
    "aerograsp/Grasp-v0": "baselines.policies.grasp:grasp_dls",
    "aerograsp/DockManipulate-v0": "baselines.policies.dock_manipulate:dls",
    "aerograsp/GraspDual-v0": "baselines.policies.grasp_dual:dual_dls",
    "aerograsp/GraspPlan-v0": "baselines.policies.grasp_plan:gpis",
    "aerograsp/Reach-v0": "baselines.policies.reach:dls",
}


def register_envs() -> None:
    """Register every id once; also the target of the `gymnasium.envs` plugin entry point."""
    for env_id, (single, batched) in ENTRY_POINTS.items():
        if env_id not in gymnasium.registry:
            gymnasium.register(
                env_id,
                single,
                vector_entry_point=batched,
                max_episode_steps=EPISODE_STEPS[env_id],
                order_enforce=False,  # the environments check order and actions themselves:
                disable_env_checker=True,  # two wrappers fewer in every step
            )


def reference_policy(env_id: str) -> Policy:
    """The analytic policy of `env_id`, resolved lazily from its string.

    Raises ValueError for an id that has none, naming the nearest that do.
    """
    if env_id not in REFERENCE_POLICIES:
        near = difflib.get_close_matches(str(env_id), REFERENCE_POLICIES, n=3, cutoff=0.4)
        hint = f"; nearest: {', '.join(near)}" if near else ""
        raise ValueError(f"no reference policy for {env_id!r}; ids: {', '.join(REFERENCE_POLICIES)}{hint}")
    module, _, name = REFERENCE_POLICIES[env_id].partition(":")
    factory: Any = getattr(importlib.import_module(module), name)
    return factory()
