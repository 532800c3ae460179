"""A flying vehicle with arms that move: scene, compiled step, worlds; tasks stand on it."""
