"""What a policy that grasps remembers, and its timing and thresholds."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.grasping.reaching import Reached
from baselines.grasping.scenes import Scene
from baselines.kinematics.tracking import Track

Array = NDArray[np.float64]


class Phase(IntEnum):
    """What is being done."""

    LOOK = 0  # the track settles
    TRANSIT = 1  # base and arms to where the approach begins
    ALIGN = 2  # tools at the pre-grasps
    APPROACH = 3
    CLOSE = 4
    LIFT = 5
    RELEASE = 6  # jaws open
    RETREAT = 7  # tools back off


class Manoeuvre(NamedTuple):
    """A grasp for every arm, and where the base puts the object."""

    hands: tuple[Reached, ...]
    T_level_object: Array  # (4, 4)
    plan: tuple[Reached, ...] = ()  # of one arm: what else the plan found
    chosen: int = 0  # of the grasp in it


class Attempt(NamedTuple):
    """A manoeuvre that was given up."""

    scene: Scene  # that it was planned in
    grasp: Reached  # of the first arm
    moved: Array  # (3,) of that tool from its grasp when the jaws began to close, or at the end: grasp's frame [m]
    ended: Phase  # in which it was given up: LIFT, if the object slipped
    opening: float  # of the jaws then [m]


class Pilot(NamedTuple):
    """What is remembered of one episode."""

    track: Track
    phase: Phase
    since: int  # steps in this phase
    manoeuvre: Manoeuvre | None
    seat: Array  # (3,) where the base should have the seat, from the body's origin, level axes [m]
    above: float  # that the base stays higher in transit [m]
    travel: float  # of the tools still to go along their approach axes [m]
    anchors: Array  # (arms, 4, 4) tool poses where the jaws close; positions from the seat, level axes
    height: float  # by which the base was told to lift [m]
    settled: int  # steps in a row for which the phase's aim has been met
    stuck: int  # steps in a row for which the tools have come no nearer on the approach
    attempts: tuple[Attempt, ...]  # that failed
    scene: Scene | None  # that the manoeuvre was planned in
    moved: Array  # (3,) of the first tool from its grasp when the jaws began to close: grasp's frame [m]
    misses: int  # how often the jaws closed on nothing
    deeper: float  # than planned that the tools go, along their approach axes [m]

    @property
    def grasps(self) -> tuple[Reached, ...]:
        """Of the manoeuvre, one for every arm; none while there is no manoeuvre."""
        return self.manoeuvre.hands if self.manoeuvre is not None else ()


@dataclass(frozen=True)
class PilotSettings:
    """Timing and thresholds; lengths in metres, times in seconds."""

    step: float = 0.02
    velocity_limit: float = 0.5  # of a full action [m/s]
    joint_rate: float = 2.0  # [rad/s]
    look: float = 0.3
    back: float = 0.09  # of the pre-grasp, as planned
    above: float = 0.10  # that the base stays higher until the arms are ready, at least
    over: float = 0.03  # of the tools over the object's top meanwhile
    highest: float = 0.30  # that it goes for this
    low: float = 0.06  # height that it may lack when it moves sideways, or the arms reach out
    base_gain: float = 1.3  # [1/s]
    base_speed: float = 0.30
    posture_rate: float = 1.2  # of joints in transit [rad/s]
    near: float = 0.05  # of the base to its place, where the approach may begin
    aligned: float = 0.012  # of the tools
    aligned_turn: float = 0.12  # [rad]
    approach_speed: float = 0.08
    blocked: float = 0.5  # time without progress on the approach: something is in the way
    nearly: float = 0.012  # travel from which the jaws are closed none the less
    reached: float = 0.006  # of the tools at the grasp
    room: float = 0.05  # that the jaws are opened wider than the object
    stalled: float = 0.85  # load from which the jaws hold something
    lift_speed: float = 0.15
    lift: float = 0.28
    held: float = 0.35  # of the object's width: jaws that are less open hold nothing
    stale: float = 0.3  # age of the estimate from which the arms hold
    lost: float = 1.0  # and from which they back off
    retreat: float = 0.10
    reconsider: float = 1.0  # of servoing in vain, between two looks at the plan's other grasps
    deeper: float = 0.007  # after each miss
    tip_room: float = 0.012  # of the tool's origin over the support


LIMITS = {  # longest times [s]
    Phase.TRANSIT: 6.0,
    Phase.ALIGN: 2.5,
    Phase.APPROACH: 5.0,
    Phase.CLOSE: 2.6,
}
