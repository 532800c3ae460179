"""Arms, worm grippers and the vehicles that carry them: one description, and the models made from it."""
