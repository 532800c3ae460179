"""The pinned seeds. Episode k of a run resets with `seed + k`; the three ranges never meet.

| range | use |
| --- | --- |
| `TEST_SEEDS` | every figure that is reported; nothing is ever chosen on them |
| `VALIDATION_SEEDS` | choosing: gains, checkpoints, hyper-parameters, calibration |
| `TRAIN_SEEDS` | collecting experience to learn from |
"""

TEST_SEEDS = range(1_000_000, 2_000_000)
VALIDATION_SEEDS = range(2_000_000, 3_000_000)
TRAIN_SEEDS = range(3_000_000, 4_000_000)

TEST_SEED = TEST_SEEDS.start
VALIDATION_SEED = VALIDATION_SEEDS.start
TRAIN_SEED = TRAIN_SEEDS.start
