"""What learns, what compares, and the command line.

`load_policy` and `evaluate` are resolved on first use, so that `import agents` costs nothing.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from agents.evaluation import evaluate
    from agents.policies import load_policy

__all__ = ["evaluate", "load_policy"]

_HOMES = {"evaluate": "agents.evaluation", "load_policy": "agents.policies"}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'agents' has no attribute {name!r}")
    from importlib import import_module

    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
