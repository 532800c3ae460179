"""How the rows of a kind of task are compared: what is shown, what is best, and what rows are set against."""

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agents.policies import LEARNED
from agents.statistics import Interval, bootstrap_interval, is_binary, mean, wilson_interval

if TYPE_CHECKING:
    from agents.table import Row

Estimator = Callable[[NDArray[np.float64]], tuple[float, Interval]]


def mean_of(values: NDArray[np.float64]) -> tuple[float, Interval]:
    """Mean with its bootstrap interval."""
    return float(mean(values)), bootstrap_interval(values, 0, mean)


def median_of(values: NDArray[np.float64]) -> tuple[float, Interval]:
    """Median with its bootstrap interval."""
    return float(np.median(values)), bootstrap_interval(values, 0, lambda of: np.median(of, axis=-1))


def rate_of(values: NDArray[np.float64]) -> tuple[float, Interval]:
    """Share of ones with Wilson's interval, which stays honest at 0 and 1; bootstrap for shares over trainings."""
    if is_binary(values):
        return float(mean(values)), wilson_interval(int(values.sum()), values.size)
    return mean_of(values)


class Column(NamedTuple):
    """How one value is shown."""

    name: str
    head: str
    scale: float = 1.0
    digits: int = 3
    interval: bool = False
    estimator: Estimator = mean_of
    given: str = ""  # name of a 0/1 value: over the episodes in which that is 1

    def sample(self, values: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
        """The values that the estimate is over: the defined ones, in the episodes that count."""
        found = np.asarray(values.get(self.name, ()), dtype=np.float64)
        if self.given and found.size:
            found = found[np.asarray(values[self.given]) == 1.0]
        return found[np.isfinite(found)]


@dataclass(frozen=True)
class Scoring:
    """A kind of task. Rows belong to it if they have its `primary` value; without one nothing is best."""

    columns: tuple[Column, ...]
    primary: Column | None = None
    unit: str = ""  # of the primary column as it is shown
    lower_is_better: bool = True
    outcomes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # 0/1 value → the terminations it counts
    tolerated: Mapping[str, float] = field(default_factory=dict)  # value → the largest mean that can be best
    paired: tuple[Column, ...] = ()  # what is compared episode by episode
    paired_with_analytic: bool = False  # with the best analytic row, not with the best of all
    lead: str = ""  # {policy}, {value}, {low}, {high}, {episodes}
    intervals: str = "Means over episodes, with 95 % bootstrap intervals in brackets."
    by_condition: str = ""  # what a table of policies by conditions shows
    shaded: str = ""  # what is best in it
    undefined: str = "(n): over the n episodes that lasted long enough to define it."
    marks: tuple[str, ...] = ()  # values that its rows have besides the primary one
    causes: tuple[str, ...] = ()  # 0/1 values, one of them in each episode that fails
    goodness: tuple[tuple[str, float], ...] = (("success", 1.0), ("crash", -1.0))  # values that rank episodes, signed

    def best(self, rows: Iterable["Row"], column: Column | None = None) -> "Row | None":
        """The best of rows by the mean of a column's value, the primary one's by default; None if there is none.

        Oracles, rows with an episode that does not define the value, and rows beyond `tolerated` are left out.
        """
        if self.primary is None:
            return None
        name, sign = (column or self.primary).name, 1.0 if self.lower_is_better else -1.0
        fit = [row for row in rows if not row.oracle and name in row.values and np.isfinite(row.values[name]).all()]
        for value, most in self.tolerated.items():
            fit = [row for row in fit if np.mean(row.values.get(value, np.zeros(1))) <= most]
        return min(fit, key=lambda row: sign * float(np.mean(row.values[name])), default=None)

    def reference(self, rows: Iterable["Row"]) -> "Row | None":
        """The row that the others are set against, episode by episode."""
        if self.paired_with_analytic:
            rows = [row for row in rows if not is_learned(row.policy)]
        return self.best(rows)

    def indicators(self, terminations: NDArray[np.str_]) -> dict[str, NDArray[np.float64]]:
        """Name → (E,) whether the episode ended so, 0 or 1."""
        return {name: np.isin(terminations, ends).astype(np.float64) for name, ends in self.outcomes.items()}


_ERROR = Column("error", "|error| [mm]", 1e3, 1, True)
HOLDING = Scoring(
    columns=(
        Column("error_x", "|error| x [mm]", 1e3, 1, True),
        Column("error_y", "|error| y [mm]", 1e3, 1, True),
        Column("error_z", "|error| z [mm]", 1e3, 1, True),
        _ERROR,
        Column("success", "success [%]", 1e2, 0),
        Column("crash", "crash [%]", 1e2, 0),
        Column("effort", "effort"),
    ),
    primary=_ERROR,
    unit="mm",
    tolerated={"crash": 0.01},  # a crashed episode has its error over the time before only, which flatters it
    paired=(_ERROR,),
    by_condition="Mean |error| per axis over episodes [mm], 95 % bootstrap intervals in brackets; crash rates where "
    "any.",
    shaded="Shaded: the lowest error with at most 1 % of crashes.",
    lead="The lowest error without crashes is {policy}’s: {value} mean |error| per axis, 95 % interval {low} to {high} "
    "mm over {episodes} pinned episodes.",
)

_HELD = Column("held", "held [%]", 1e2, 1, True, rate_of)
_STRICT = Column("strict", "strict [%]", 1e2, 1, True, rate_of)
GRASPING = Scoring(
    columns=(
        _HELD,
        _STRICT,
        Column("slip", "slip [mm]", 1e3, 1, True, median_of, "held"),
        Column("turn", "turn [°]", float(np.degrees(1.0)), 1, True, median_of, "held"),
        Column("collision", "collision [%]", 1e2, 1),
        Column("missed", "missed [%]", 1e2, 1),
        Column("dropped", "dropped [%]", 1e2, 1),
        Column("no grasp", "no grasp [%]", 1e2, 1),
    ),
    primary=_HELD,
    unit="%",
    lower_is_better=False,
    outcomes={
        "collision": ("collision",),
        "missed": ("missed",),
        "dropped": ("dropped", "slipped away"),
        "no grasp": ("degenerate", "too wide"),
    },
    paired=(_HELD, _STRICT),
    paired_with_analytic=True,
    by_condition="Shares of the episodes, 95 % Wilson intervals in brackets; of rows over several trainings bootstrap "
    "intervals. Strict: held, with less than 20 mm of slip and 20° of turn.",
    shaded="Shaded: the largest share, oracles aside.",
    lead="{policy} holds the most objects from one view: {value}, 95 % interval {low} to {high} % over {episodes} "
    "pinned views.",
    intervals="Shares of the episodes, with 95 % Wilson intervals in brackets; slip and turn: medians over the held "
    "grasps, with bootstrap intervals. Rows over several trainings: bootstrap intervals.",
)
OTHER = Scoring(columns=tuple(column for column in HOLDING.columns if column.name in ("success", "crash", "effort")))

REACHING = Scoring(
    columns=(
        Column("error", "error [mm]", 1e3, 1, True),
        Column("error_max", "largest [mm]", 1e3, 1, True),
        Column("estimate_error", "believed elsewhere by [mm]", 1e3, 1, True),
        Column("hover", "hover moved [mm]", 1e3, 1, True),
        Column("crash", "crash [%]", 1e2, 1),
        Column("contacts", "contacts [steps]", digits=1),
        Column("effort", "effort"),
    ),
    primary=Column("error", "error [mm]", 1e3, 1, True),
    unit="mm",
    tolerated={"crash": 0.01},
    paired=(Column("error", "error [mm]", 1e3, 1, True),),
    paired_with_analytic=True,
    by_condition="Mean distance of the tool from its target, as the environment counts it [mm], "
    "95 % bootstrap intervals in brackets; crash rates where any.",
    shaded="Shaded: the lowest error with at most 1 % of crashes.",
    lead="The lowest error without crashes is {policy}’s{where}: {value} from tool to target on average, 95 % interval "
    "{low} to {high} mm over {episodes} pinned episodes.",
    marks=("error_max", "hover"),
    goodness=(("crash", -1.0), ("error", -1.0)),
)

_LIFTED = Column("success", "success [%]", 1e2, 1, True, rate_of)
CAUSES = ("missed", "slipped", "collided", "jammed", "timed_out")  # of failures, one each
LIFTING = Scoring(
    columns=(
        _LIFTED,
        Column("crash", "crash [%]", 1e2, 1, True, rate_of),
        *(Column(cause, f"{cause.replace('_', ' ')} [%]", 1e2, 1) for cause in CAUSES),
        Column("slip", "slip [mm]", 1e3, 1, True, median_of, "success"),
        Column("effort", "effort"),
    ),
    primary=_LIFTED,
    unit="%",
    lower_is_better=False,
    paired=(_LIFTED,),
    paired_with_analytic=True,
    by_condition="Shares of the episodes in which the object was lifted and held, 95 % Wilson intervals in brackets "
    "(of rows over several trainings bootstrap intervals); crash rates where any.",
    shaded="Shaded: the largest share, oracles aside.",
    lead="{policy} lifts the most objects{where}: {value}, 95 % interval {low} to {high} % over {episodes} pinned "
    "episodes.",
    intervals="Shares of the episodes, with 95 % Wilson intervals in brackets; slip: median over the successes, with a "
    "bootstrap interval. Rows over several trainings: bootstrap intervals.",
    marks=("lift", *CAUSES),
    causes=CAUSES,
    goodness=(("success", 1.0), ("crash", -1.0), ("lift_time", -1.0), ("lift", 1.0)),
)
DETECTING = Scoring(
    columns=(
        Column("success", "success [%]", 1e2, 0, True, rate_of),
        Column("map50", "mAP@0.5", 1.0, 2, True),
        Column("map75", "mAP@0.75", 1.0, 2),
        Column("recall", "recall", 1.0, 2),
        Column("f1", "F1", 1.0, 2, True),
        Column("add_s", "ADD-S ≤ 0.1 d [%]", 1e2, 0),
        Column("position_error", "position [mm]", 1e3, 1, True),
        Column("rotation_error", "rotation [°]", float(np.degrees(1.0)), 1),
        Column("jumps", "jumps", digits=1),
    ),
    primary=Column("success", "success [%]", 1e2, 0, True, rate_of),
    unit="%",
    lower_is_better=False,
    paired=(Column("success", "success [%]", 1e2, 0, True, rate_of), Column("f1", "F1", 1.0, 2, True)),
    by_condition="Shares of the episodes with an F1 of at least 0.7 at IoU 0.5 and a median position error of at most "
    "20 mm, 95 % Wilson intervals in brackets.",
    shaded="Shaded: the largest share, oracles aside.",
    lead="{policy} succeeds most often{where}: {value}, 95 % interval {low} to {high} % over {episodes} pinned "
    "episodes.",
    intervals="Means over episodes of each episode’s value over its frames, with 95 % bootstrap intervals in brackets; "
    "success: Wilson intervals. Position and rotation: the episode’s medians over what was found.",
    undefined="(n): over the n episodes in which anything was found.",
    marks=("map50", "f1"),
    goodness=(("success", 1.0), ("f1", 1.0)),
)
_KINDS = (LIFTING, DETECTING, REACHING, HOLDING, GRASPING)
_RETURN = Column("returns", "return", 1.0, 2, True)


def scoring_of(names: Iterable[str]) -> Scoring:
    """The kind of task whose rows have values of these names."""
    present = set(names)
    fit = [kind for kind in _KINDS if kind.primary is not None and {kind.primary.name, *kind.marks} <= present]
    return fit[0] if fit else OTHER


def columns_of(names: Iterable[str]) -> list[Column]:
    """The columns for values of these names: the kind's in its order, else return, success and every metric."""
    present = set(names)
    kind = scoring_of(present)
    known = [column for column in kind.columns if column.name in present]
    if kind is not OTHER or not present:
        return known or list(HOLDING.columns)
    others = sorted(present - {column.name for column in HOLDING.columns} - {"returns", "lengths"})
    return [_RETURN, *known, *(Column(name, name, interval=True) for name in others)]


def is_learned(policy: str) -> bool:
    """Whether a row is a trained policy: "ppo", "learned-seed0", "ppo (3 seeds)", a weights file."""
    return policy.endswith(".safetensors") or bool(re.fullmatch(rf"({'|'.join(LEARNED)})(-seed\d+| \(.*\))?", policy))
