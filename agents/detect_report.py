"""What `aerograsp bench` adds to the report of Detect-v0: films, all levels in one table, paired differences."""

from __future__ import annotations

from agents.bench_setup import Measured, Study
from agents.manipulation_films import films_section
from agents.manipulation_report import conditions_section, paired_section

FILMED = ("clusters+icp", "cnn+icp")


def study(measured: Measured) -> Study:
    """Films of the best and the worst episode of an analytic and of the learned policy, levels, paired differences."""
    films = [part for policy in FILMED for part in films_section(measured, policy)]
    return Study([*films, *conditions_section(measured.conditions), *paired_section(measured)], {})
