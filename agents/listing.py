"""`aerograsp list`: the registered ids, what they are, and the policies each has."""

import sys
from typing import Any

from gymnasium.envs.registration import load_env_creator

from agents.arguments import Parser, add_json, guarded
from agents.files import write_json
from agents.policies import env_ids, env_spec, policy_names


def catalogue() -> list[dict[str, Any]]:
    """One entry an id: id, summary (first line of its docstring), policies, steps of an episode, batched or not."""
    entries = []
    for env_id in env_ids():
        spec = env_spec(env_id)
        creator = spec.entry_point if callable(spec.entry_point) else load_env_creator(str(spec.entry_point))
        entries.append(
            {
                "id": env_id,
                "summary": (creator.__doc__ or "").strip().partition("\n")[0],
                "policies": policy_names(env_id),
                "max_episode_steps": spec.max_episode_steps,
                "batched": spec.vector_entry_point is not None,
            }
        )
    return entries


def main(argv: list[str]) -> int:
    parser = Parser(prog="aerograsp list", description="The environments and their policies.")
    add_json(parser)
    args = parser.parse_args(argv)
    entries = catalogue()
    if args.json != "-":
        for entry in entries:
            print(entry["id"] + ("  (batched)" if entry["batched"] else ""))
            print(f"    {entry['summary']}")
            print(f"    policies: {', '.join(entry['policies'])}")
    if args.json:
        write_json(args.json, entries)
    return 0


if __name__ == "__main__":
    sys.exit(guarded("aerograsp list", main, sys.argv[1:]))
