"""What `aerograsp bench` runs on each id: conditions, rows, episodes, and what its report adds."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from agents.policies import TRIVIAL, checkpoints, registered_policies
from agents.table import Published, Row

DOCK, GRASP_PLAN = "aerograsp/Dock-v0", "aerograsp/GraspPlan-v0"
REACH, GRASP = "aerograsp/Reach-v0", "aerograsp/Grasp-v0"
DETECT = "aerograsp/Detect-v0"
GRASP_DUAL, DOCK_MANIPULATE = "aerograsp/GraspDual-v0", "aerograsp/DockManipulate-v0"


class Condition(NamedTuple):
    """One of the circumstances that an id's policies are compared under."""

    changes: dict[str, Any]  # what differs from the id's common options
    options: dict[str, Any]  # all of the environment's
    rows: list[Row]  # as `agents.robustness.measured_rows` gives them


class Measured(NamedTuple):
    """A comparison's rows, and what they were measured with, for an id's own study of them."""

    env_id: str
    env_kwargs: dict[str, Any]
    seed: int  # of episode 0
    episodes: int
    rows: list[Row]  # all that ran, pooled ones after their trainings
    policies: dict[str, Any]  # by name, those that ran
    quick: bool
    progress: bool
    conditions: dict[str, Condition] = {}  # noqa: RUF012 (never changed) by name; the first is that of `rows`


class Study(NamedTuple):
    """What an id's report adds."""

    sections: list[str]  # HTML
    data: dict[str, Any]  # for results.json


@dataclass(frozen=True)
class Setup:
    """A comparison as it is run unless the command says otherwise."""

    options: Mapping[str, Any] = field(default_factory=dict)  # of the environment
    episodes: int = 100
    learned: tuple[str, ...] = ("ppo", "ppo-residual")  # kinds that a row says are missing where none is shipped
    quick_options: Mapping[str, Any] = field(default_factory=lambda: {"max_episode_steps": 1000})  # 20 s at 50 Hz
    quick_episodes: int = 10
    quick_rows: tuple[str, ...] = (*TRIVIAL, "pid", "pid-tuned", "lqg", "ppo")
    published: tuple[Published, ...] = ()
    film_episodes: int = 1  # of the best row; 0: none, for the study has films of its own
    conditions: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # name → changes; the first comes first
    filmed: tuple[str, ...] = ()  # conditions that the study chooses its films from; by default the first
    look: Mapping[str, Any] = field(default_factory=dict)  # options of the films' pictures
    study: str = ""  # "module:function" of what the report adds: `study(Measured) -> Study`

    def rows(self, env_id: str, quick: bool) -> list[str]:
        """The rows of a comparison: quick, or every analytic policy and every training seed that is shipped."""
        analytic, shipped = list(registered_policies(env_id)), checkpoints(env_id)
        if quick:
            return [name for name in self.quick_rows if name in (*TRIVIAL, *self.learned) or name in analytic]
        seeds = [name for name in shipped if re.fullmatch(r".+-seed\d+", name)]
        missing = [kind for kind in self.learned if not any(name.startswith(f"{kind}-seed") for name in seeds)]
        return [*TRIVIAL, *analytic, *seeds, *missing]

    def conditions_under(self, env_kwargs: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
        """Name → changes of the conditions that these options of a caller do not contradict, at least one."""
        fit = {
            name: dict(changes)
            for name, changes in self.conditions.items()
            if all(env_kwargs.get(option, value) == value for option, value in changes.items())
        }
        return fit or {"": {}}


SETUPS: dict[str, Setup] = {
    DOCK: Setup(
        options={"wind": "gusty", "command_delay": (0.06, 0.1)},
        published=(
            Published(
                "thesis, docking tool",
                {"error_x": (0.034, 0.032), "error_y": (0.036, 0.028), "error_z": (0.040, 0.039)},
                "P. Ramon Soria, PhD thesis, 2018, Table 5.3: mean ± standard deviation of the held position's error, "
                "real vehicle and wind, total station; not the conditions simulated here.",
            ),
        ),
    ),
    GRASP_PLAN: Setup(
        options={"objects": "test"},
        episodes=375,  # the fifteen test objects in turn, 25 views of each
        learned=("learned",),
        quick_options={},
        quick_episodes=30,
        quick_rows=("random", "com", "cloud", "gpis", "learned", "oracle-mesh"),
        film_episodes=4,
        study="agents.grasp_report:study",
    ),
    REACH: Setup(
        learned=("sac-her",),
        conditions={
            "moving": {},  # at 0.1 m/s, in light wind
            "fixed": {"target_speed": 0.0},
            "gusts": {"wind": "gusty"},
            "delay": {"command_delay": (0.06, 0.1)},
            "payload": {"payload": 0.3},
            "estimated": {"pose": "estimated"},
            "GPS": {"localization": "gps"},
        },
        quick_options={},
        quick_rows=(*TRIVIAL, "dls", "dls-no-feedforward", "sac-her"),
        film_episodes=0,
        study="agents.manipulation_report:study",
    ),
    GRASP: Setup(
        options={"objects": "test"},
        episodes=200,
        learned=("learned",),
        conditions={level: {"level": level} for level in ("easy", "gusty", "biased", "oblique", "heavy", "combined")},
        filmed=("easy", "gusty", "biased", "oblique", "heavy", "combined"),
        quick_options={},
        quick_episodes=5,
        quick_rows=("zero", "grasp-dls", "learned"),
        film_episodes=0,
        study="agents.manipulation_report:lifting_study",
    ),
    GRASP_DUAL: Setup(
        learned=(),
        conditions={level: {"level": level} for level in ("easy", "gusty")},
        filmed=("easy", "gusty"),
        quick_options={},
        quick_episodes=5,
        quick_rows=("zero", "dual-dls"),
        film_episodes=0,
        study="agents.manipulation_report:lifting_study",
    ),
    DOCK_MANIPULATE: Setup(
        learned=("ppo-residual",),
        conditions={
            "docked": {"docked": True, "localization": "dock"},
            "hovering on vision": {"docked": False, "localization": "vision"},
            "hovering on GPS": {"docked": False, "localization": "gps"},
        },
        filmed=("docked",),
        look={"camera": "front"},
        quick_options={},
        quick_episodes=5,
        quick_rows=("zero", "dock-dls", "dock-dls-pid", "ppo-residual"),
        film_episodes=0,
        study="agents.manipulation_report:docked_study",
    ),
    DETECT: Setup(
        episodes=25,
        learned=(),
        conditions={level: {"level": level} for level in ("easy", "cluttered", "dark", "blurred")},
        filmed=("easy", "cluttered", "dark", "blurred"),
        quick_options={"max_episode_steps": 10},
        quick_episodes=5,
        quick_rows=(*TRIVIAL, "clusters+icp", "cnn+icp"),
        film_episodes=0,
        study="agents.detect_report:study",
    ),
}


def setup_of(env_id: str) -> Setup:
    """The id's own setup, or the common one."""
    return SETUPS.get(env_id, Setup())
