"""aerograsp: Gymnasium environments for aerial manipulation. Importing this package registers every id, no more."""

from aerograsp_env.registration import reference_policy, register_envs

__version__ = "0.1.0"
__all__ = ["__version__", "reference_policy", "register_envs"]

register_envs()
