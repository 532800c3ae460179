"""Grasping from the air with one arm or two: what is done when, and the commands that do it.

The base goes to where the plan wants the object, a little higher, while the arms take their pre-grasp postures; it
comes down, the tools servo to their pre-grasps and along the approach axes to the grasps, the jaws close until their
motors stall, and the base lifts. What was missed is let go, and the next grasp is planned from where the object lies
then. Only observations are read; one row of a batch at a time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.grasping.reranking import rerank
from baselines.grasping.scenes import Scene
from baselines.kinematics.arm import Arm
from baselines.kinematics.servo import ServoSettings, joint_rates, servo_rates, target_twist
from baselines.kinematics.tracking import TrackSettings, attitude_matrix, start_track, update_track
from baselines.policies.grasp_margins import depth_after, height_over
from baselines.policies.grasp_reading import Hand, Reading
from baselines.policies.grasp_state import LIMITS, Attempt, Manoeuvre, Phase, Pilot, PilotSettings

Array = NDArray[np.float64]


Planner = Callable[[Scene, tuple[Attempt, ...]], Manoeuvre | None]
"""From a scene and what has failed before."""


class Flight:
    """The rules. Holds no state of an episode.

    Args:
        arms: in the order of the actions, poses in the body frame.
        planner: finds a manoeuvre.
        settings: timing and thresholds.
        track, servo: of the filter and of the arms.
    """

    def __init__(
        self,
        arms: tuple[Arm, ...],
        planner: Planner,
        settings: PilotSettings | None = None,
        track: TrackSettings | None = None,
        servo: ServoSettings | None = None,
    ) -> None:
        self.arms, self.planner = arms, planner
        self.settings = PilotSettings() if settings is None else settings
        self.track_settings = TrackSettings(step=self.settings.step) if track is None else track
        self.servo = ServoSettings(step=self.settings.step, rate=self.settings.joint_rate) if servo is None else servo
        self.joints = tuple(arm.n for arm in arms)
        self.size = 3 + sum(n + 1 for n in self.joints)

    # --- one step -----------------------------------------------------------------------------------------------------

    def step(self, r: Reading, pilot: Pilot | None) -> tuple[Array, Pilot]:
        """The action (A,) in [−1, 1] and what to remember."""
        p = self._begin(r) if pilot is None else self._follow(r, pilot)
        if r.age > self.settings.stale and p.phase != Phase.LIFT:
            return self._without_sight(r, p)
        p = self._advance(r, p)
        return self._command(r, p), p

    def _begin(self, r: Reading) -> Pilot:
        track = start_track(r.T_body_object, r.support[1:], r.rpy, r.velocity)
        n = len(self.arms)
        seat = track.points[1] - track.at
        return Pilot(
            track, Phase.LOOK, 0, None, seat, 0.0, self.settings.back, np.zeros((n, 4, 4)), 0.0, 0, 0, (), None,
            np.zeros(3), 0, 0.0,
        )  # fmt: skip

    def _follow(self, r: Reading, p: Pilot) -> Pilot:
        track = update_track(p.track, r.T_body_object, r.support[1:], r.age, r.rpy, r.velocity, self.track_settings)
        return p._replace(track=track, since=p.since + 1)

    def _go(self, p: Pilot, phase: Phase, **changes: Any) -> Pilot:
        return p._replace(phase=phase, since=0, settled=0, stuck=0, **changes)

    # --- what to do next ----------------------------------------------------------------------------------------------

    def _advance(self, r: Reading, p: Pilot) -> Pilot:
        s = self.settings
        time = p.since * s.step
        late = time > LIMITS.get(p.phase, np.inf)
        if p.phase == Phase.LOOK:
            return self._plan(r, p) if time >= s.look else p
        if p.phase == Phase.TRANSIT:
            x, y, z = self._base_error(p, 0.0)
            # once in posture, the arms may come down from any height: after a retreat there is no need to climb
            ready = np.hypot(x, y) < s.near and -s.near < -z < p.above + s.near and self._postured(r, p)
            return self._go(p, Phase.ALIGN) if ready or late else p
        if p.phase == Phase.ALIGN and self._high(p):
            return p._replace(since=0)
        if p.phase == Phase.ALIGN:
            error, turn = self._tool_error(r, p)
            good = error < s.aligned and turn < s.aligned_turn
            p = p._replace(settled=p.settled + 1 if good else 0)
            if p.settled >= 3:
                return self._go(p, Phase.APPROACH)
            return self._give_up(r, p) if late else self._reconsider(p)
        if p.phase == Phase.APPROACH:
            return self._approach(r, p, late)
        if p.phase == Phase.CLOSE:
            return self._close(r, p, late)
        if p.phase == Phase.LIFT:
            empty = any(
                hand.opening < s.held * grasp.width - 0.001 for hand, grasp in zip(r.hands, p.grasps, strict=True)
            )
            p = p._replace(height=min(p.height + s.lift_speed * s.step, s.lift), settled=p.settled + 1 if empty else 0)
            return self._give_up(r, p) if p.settled >= 10 else p
        if p.phase == Phase.RELEASE:
            return self._go(p, Phase.RETREAT) if time > 0.5 else p
        return self._go(p, Phase.LOOK, manoeuvre=None) if time > 0.8 else p  # RETREAT

    def _plan(self, r: Reading, p: Pilot) -> Pilot:
        T = p.track.pose
        level = np.eye(4)
        level[:3, :3] = p.track.attitude
        T = level @ T
        seat = p.track.points[1] - p.track.at
        # the support's normal errs with the object's rotation, which has been filtered: keep them together
        up = p.track.rotation @ (r.T_body_object[:3, :3].T @ r.support[0])
        scene = Scene(T, r.cloud[:, :3], r.cloud[:, 3:], seat, up / np.linalg.norm(up))
        manoeuvre = self.planner(scene, p.attempts)
        if manoeuvre is None:
            return p._replace(since=0)
        wanted = seat + manoeuvre.T_level_object[:3, 3] - T[:3, 3]
        s, angles = self.settings, [hand.q for hand in r.hands]
        deeper = min(depth_after(p.misses, scene, grasp, s) for grasp in manoeuvre.hands)
        above = height_over(scene, manoeuvre, self.arms, angles, s)
        changes: dict[str, Any] = {"seat": wanted, "above": above, "travel": s.back, "height": 0.0, "deeper": deeper}
        return self._go(p, Phase.TRANSIT, manoeuvre=manoeuvre, scene=scene, **changes)

    def _reconsider(self, p: Pilot) -> Pilot:
        """Another grasp of the plan, where the one that is being done has left the arm's workspace."""
        s, m = self.settings, p.manoeuvre
        if m is None or len(m.plan) < 2 or p.settled or p.since % round(s.reconsider / s.step):
            return p
        choice = rerank(self.arms[0], m.plan, p.track.pose, m.chosen, s.back)
        if choice.chosen < 0 or choice.scores[m.chosen] > 0.0:
            return p
        grasp = m.plan[choice.chosen]
        seat = p.seat + grasp.T_level_object[:3, 3] - m.T_level_object[:3, 3]
        changed = Manoeuvre((grasp,), grasp.T_level_object, m.plan, choice.chosen)
        return self._go(p, Phase.TRANSIT, manoeuvre=changed, seat=seat, above=s.highest, travel=s.back)

    def _approach(self, r: Reading, p: Pilot, late: bool) -> Pilot:
        s = self.settings
        error, turn = self._tool_error(r, p)
        travel, stuck = p.travel, p.stuck + 1
        if error < 1.5 * s.aligned and turn < 1.5 * s.aligned_turn:
            travel, stuck = max(travel - s.approach_speed * s.step, 0.0), 0
        p = p._replace(travel=travel, stuck=stuck, settled=p.settled + 1 if travel <= 0.0 and error < s.reached else 0)
        late = late or stuck * s.step > s.blocked
        if p.settled < 3 and not late:
            return p
        if travel > s.nearly:
            return self._give_up(r, p)
        return self._go(p, Phase.CLOSE, anchors=self._anchors(p), moved=self._moved(r, p))

    def _close(self, r: Reading, p: Pilot, late: bool) -> Pilot:
        s = self.settings
        grips = [hand.load > s.stalled for hand in r.hands]
        p = p._replace(settled=p.settled + 1 if all(grips) else 0)
        full = [hand.opening > s.held * grasp.width for hand, grasp in zip(r.hands, p.grasps, strict=True)]
        if not all(full):
            return self._give_up(r, p._replace(misses=p.misses + 1))
        if p.settled < 5 and not late:
            return p
        return self._go(p, Phase.LIFT) if all(hand.load > 0.3 * s.stalled for hand in r.hands) else self._give_up(r, p)

    def _give_up(self, r: Reading, p: Pilot) -> Pilot:
        assert p.scene is not None  # there is a manoeuvre
        moved = p.moved if p.phase in (Phase.CLOSE, Phase.LIFT) else self._moved(r, p)
        attempt = Attempt(p.scene, p.grasps[0], moved, p.phase, r.hands[0].opening)
        return self._go(p, Phase.RELEASE, attempts=(*p.attempts, attempt))

    # --- where things are ---------------------------------------------------------------------------------------------

    def _base_error(self, p: Pilot, above: float) -> Array:
        """(3,) how far the body has to go [m], odometry axes, to be `above` its place."""
        return np.asarray(p.track.points[1] - p.track.at - p.seat + (0.0, 0.0, above))

    def _high(self, p: Pilot) -> bool:
        """Whether the base has still to come down."""
        return bool(-self._base_error(p, 0.0)[2] > self.settings.low)

    def _target(self, p: Pilot, k: int) -> Array:
        """T_body_tool (4, 4) wanted of an arm's tool now."""
        if p.phase == Phase.CLOSE:
            T = np.eye(4)
            T[:3, :3] = p.track.attitude.T @ p.anchors[k, :3, :3]
            T[:3, 3] = p.track.point(1) + p.track.attitude.T @ p.anchors[k, :3, 3]
            return T
        T = p.track.pose @ p.grasps[k].T_object_grasp
        T[:3, 3] -= (p.travel - p.deeper) * T[:3, 2]
        return np.asarray(T)

    def _anchors(self, p: Pilot) -> Array:
        """Where the tools are wanted, held to the seat: the object moves when it is touched."""
        anchors = np.tile(np.eye(4), (len(self.arms), 1, 1))
        for k in range(len(self.arms)):
            T = self._target(p, k)
            anchors[k, :3, :3] = p.track.attitude @ T[:3, :3]
            anchors[k, :3, 3] = p.track.attitude @ (T[:3, 3] - p.track.point(1))
        return anchors

    def _moved(self, r: Reading, p: Pilot) -> Array:
        """(3,) of the first tool from its grasp, by the estimate, in the grasp's frame [m]."""
        T = p.track.pose @ p.grasps[0].T_object_grasp
        return np.asarray(T[:3, :3].T @ (r.hands[0].tool[:3, 3] - T[:3, 3]))

    def _tool_error(self, r: Reading, p: Pilot) -> tuple[float, float]:
        """The largest distance [m] and angle [rad] of a tool from its target."""
        error = turn = 0.0
        for k, hand in enumerate(r.hands):
            T = self._target(p, k)
            error = max(error, float(np.linalg.norm(T[:3, 3] - hand.tool[:3, 3])))
            cosine = 0.5 * (np.einsum("ij,ij", T[:3, :3], hand.tool[:3, :3]) - 1.0)
            turn = max(turn, float(np.arccos(np.clip(cosine, -1.0, 1.0))))
        return error, turn

    def _postured(self, r: Reading, p: Pilot) -> bool:
        pairs = zip(r.hands, p.grasps, strict=True)
        return all(bool(np.abs(hand.q - grasp.q_before).max() < 0.15) for hand, grasp in pairs)

    # --- commands -----------------------------------------------------------------------------------------------------

    def _without_sight(self, r: Reading, p: Pilot) -> tuple[Array, Pilot]:
        """The arms hold; if the estimate stays away, jaws open and the base climbs, and all begins anew."""
        rates = [np.zeros(n) for n in self.joints]
        velocity, drive = p.track.drifts[1].copy(), 0.0
        if r.age > self.settings.lost:
            velocity[2] += 0.5 * self.settings.base_speed
            drive = -1.0
            p = self._go(p, Phase.LOOK, manoeuvre=None)
        return self._action(r, velocity, rates, [drive] * len(self.arms)), p

    def _command(self, r: Reading, p: Pilot) -> Array:
        s = self.settings
        above = p.above if p.phase == Phase.TRANSIT else s.retreat if p.phase == Phase.RETREAT else p.height
        error = self._base_error(p, above)
        if p.phase == Phase.TRANSIT:  # first up, then sideways
            error[:2] *= np.clip(2.0 - error[2] / s.low, 0.0, 1.0)
        velocity = s.base_gain * error
        speed = float(np.linalg.norm(velocity))
        velocity = velocity * min(1.0, s.base_speed / max(speed, 1e-9)) + p.track.drifts[1]
        rates, drives = [], []
        for k, hand in enumerate(r.hands):
            rates.append(self._arm_rates(r, p, k, hand))
            drives.append(self._drive(p, k, hand))
        return self._action(r, velocity, rates, drives)

    def _arm_rates(self, r: Reading, p: Pilot, k: int, hand: Hand) -> Array:
        s = self.settings
        if not p.grasps or p.phase in (Phase.LOOK, Phase.LIFT, Phase.RELEASE):
            return np.zeros(self.joints[k])
        grasp = p.grasps[k]
        if p.phase == Phase.TRANSIT and self._base_error(p, p.above)[2] > s.low:
            return np.zeros(self.joints[k])  # first up
        if (p.phase == Phase.ALIGN and self._high(p)) or p.phase in (Phase.TRANSIT, Phase.RETREAT):
            return joint_rates(hand.q + hand.lag, grasp.q_before, s.posture_rate)
        T = self._target(p, k)
        point = 1 if p.phase == Phase.CLOSE else 0
        twist = target_twist(T, p.track.attitude.T @ p.track.drifts[point], r.velocity, r.gyro)
        if p.phase == Phase.APPROACH and p.travel > 0.0:
            twist[:3] += s.approach_speed * T[:3, 2]
        return servo_rates(self.arms[k], hand.q, hand.lag, T, twist, self.servo).rates

    def _drive(self, p: Pilot, k: int, hand: Hand) -> float:
        """Of the jaws, a share of their speed: > 0 closes."""
        s = self.settings
        if p.phase in (Phase.CLOSE, Phase.LIFT):
            return 1.0
        if not p.grasps or p.phase in (Phase.RELEASE, Phase.RETREAT):
            return -1.0
        grasp = p.grasps[k]
        wanted = min(grasp.opening, grasp.width + s.room)
        return float(np.clip((hand.opening - wanted) / 0.01, -1.0, 1.0)) if abs(hand.opening - wanted) > 0.002 else 0.0

    def _action(self, r: Reading, velocity: Array, rates: list[Array], drives: list[float]) -> Array:
        """Scaled; the velocity (3,) is in odometry axes and goes out in the heading's."""
        s = self.settings
        heading = attitude_matrix((0.0, 0.0, float(r.rpy[2])))
        parts = [heading.T @ velocity / s.velocity_limit]
        for rate, drive in zip(rates, drives, strict=True):
            parts += [rate / s.joint_rate, np.array([drive])]
        return np.clip(np.concatenate(parts), -1.0, 1.0)
