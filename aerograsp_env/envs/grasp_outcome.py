"""What a judged grasp earns and counts in `aerograsp/GraspPlan-v0`."""

from __future__ import annotations

from aerograsp_env.rewards import tolerance
from aerograsp_env.sim.grasp_judge import STRICT_SLIP, STRICT_TURN, Judgement


def metrics(judgement: Judgement) -> dict[str, float]:
    """held, strict, survived and, where it was held, slip [m] and turn [rad]."""
    found = {"held": float(judgement.held), "strict": float(judgement.strict), "survived": judgement.survived}
    return found | ({"slip": judgement.slip, "turn": judgement.turn} if judgement.held else {})


def reward_terms(judgement: Judgement | None, mode: str) -> dict[str, float]:
    """The terms whose sum is the reward; None before anything was judged."""
    held = judgement is not None and judgement.held
    if mode == "sparse":
        return {"held": float(held)}
    terms = {"survived": 0.0 if judgement is None else 0.5 * judgement.survived, "slip": 0.0, "turn": 0.0}
    if judgement is not None and held:
        for name, value, margin in (("slip", judgement.slip, STRICT_SLIP), ("turn", judgement.turn, STRICT_TURN)):
            terms[name] = 0.25 * float(tolerance(value, margin=margin, sigmoid="linear", value_at_margin=0.0))
    return terms
