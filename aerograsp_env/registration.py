"""The suite's ids, entry points (strings: nothing is imported until an environment is made) and reference policies."""

from __future__ import annotations

import difflib
import importlib
from typing import TYPE_CHECKING, Any

import gymnasium

if TYPE_CHECKING:
    from aerograsp_env.interfaces import Policy

EPISODE_STEPS = 3000  # 60 s at 50 Hz

ENTRY_POINTS: dict[str, tuple[str, str | None]] = {  # of one world, and of a native batch where there is one
    "aerograsp/Dock-v0": ("aerograsp_env.envs.dock:DockEnv", "aerograsp_env.vector:DockVectorEnv"),
    "aerograsp/DockAttach-v0": ("aerograsp_env.envs.dock:DockAttachEnv", "aerograsp_env.vector:DockAttachVectorEnv"),
    "aerograsp/GraspPlan-v0": ("aerograsp_env.envs.grasp_plan:GraspPlanEnv", None),
}

ONE_STEP = frozenset({"aerograsp/GraspPlan-v0"})  # end by themselves at the first step: no time limit

REFERENCE_POLICIES: dict[str, str] = {
    "aerograsp/Dock-v0": "baselines.policies.dock:pid",
    "aerograsp/DockAttach-v0": "baselines.policies.dock_attach:pid",
    "aerograsp/GraspPlan-v0": "baselines.policies.grasp_plan:gpis",
}


def register_envs() -> None:
    """Register every id once; also the target of the `gymnasium.envs` plugin entry point."""
    for env_id, (single, batched) in ENTRY_POINTS.items():
        if env_id not in gymnasium.registry:
            gymnasium.register(
                env_id,
                single,
                vector_entry_point=batched,
                max_episode_steps=None if env_id in ONE_STEP else EPISODE_STEPS,
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
