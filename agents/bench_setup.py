"""What `aerograsp bench` runs on each id: conditions, rows, episodes, and what its report adds."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from agents.policies import TRIVIAL, checkpoints, registered_policies
from agents.table import Published, Row

DOCK, GRASP_PLAN = "aerograsp/Dock-v0", "aerograsp/GraspPlan-v0"


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
    film_episodes: int = 1
    study: str = ""  # "module:function" of what the report adds: `study(Measured) -> Study`

    def rows(self, env_id: str, quick: bool) -> list[str]:
        """The rows of a comparison: quick, or every analytic policy and every training seed that is shipped."""
        analytic, shipped = list(registered_policies(env_id)), checkpoints(env_id)
        if quick:
            return [name for name in self.quick_rows if name in (*TRIVIAL, *self.learned) or name in analytic]
        seeds = [name for name in shipped if re.fullmatch(r".+-seed\d+", name)]
        missing = [kind for kind in self.learned if not any(name.startswith(f"{kind}-seed") for name in seeds)]
        return [*TRIVIAL, *analytic, *seeds, *missing]


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
}


def setup_of(env_id: str) -> Setup:
    """The id's own setup, or the common one."""
    return SETUPS.get(env_id, Setup())
