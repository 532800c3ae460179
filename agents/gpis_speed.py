"""Speed of implicit surfaces, as ratios to the bare matrix products of the same shapes and to GPyTorch.

`python -m agents.gpis_speed [--peer-python PYTHON]`: one run, one BLAS thread, warm, medians taken in turns.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
QUERY_POINTS, QUERIES, FIT_POINTS = 300, 10_000, 1000
LENGTH_SCALE, NOISE, NORMAL_NOISE = 0.05, 1e-2, 5e-2

PEER_SCRIPT = r"""
import json, sys, time
import torch, gpytorch
torch.set_num_threads(1)
torch.set_default_dtype(torch.float64)
count, queries, repeats, length_scale, noise = json.loads(sys.argv[1])
generator = torch.Generator().manual_seed(0)
normals = torch.randn(count, 3, generator=generator)
normals = normals / normals.norm(dim=1, keepdim=True)
points = 0.1 * normals
x = 0.3 * torch.rand(queries, 3, generator=generator) - 0.15
targets = torch.cat([torch.zeros(count, 1), normals], dim=1)

class Model(gpytorch.models.ExactGP):
    def __init__(self, likelihood):
        super().__init__(points, targets, likelihood)
        self.mean_module = gpytorch.means.ConstantMeanGrad()
        self.covar_module = gpytorch.kernels.ScaleKernel(gpytorch.kernels.RBFKernelGrad())
    def forward(self, x):
        return gpytorch.distributions.MultitaskMultivariateNormal(self.mean_module(x), self.covar_module(x))

likelihood = gpytorch.likelihoods.MultitaskGaussianLikelihood(num_tasks=4)
model = Model(likelihood)
model.covar_module.base_kernel.lengthscale = length_scale
likelihood.noise = noise ** 2
model.eval()
times = []
chunk = 500  # the joint covariance of all queries does not fit into memory
exact = gpytorch.settings.fast_computations(False, False, False)
with torch.no_grad(), gpytorch.settings.skip_posterior_variances(True), exact:
    model(x[:10]).mean
    for _ in range(repeats):
        start = time.perf_counter()
        for part in x.split(chunk):
            model(part).mean
        times.append(time.perf_counter() - start)
times.sort()
versions = [gpytorch.__version__, torch.__version__]
print("ANSWER " + json.dumps({"seconds": times[len(times) // 2], "versions": versions}))
"""


def medians(functions: dict[str, Callable[[], Any]], repeats: int) -> dict[str, float]:
    """Median wall seconds of each, after one call to warm up, all in turns so that a slow spell hits all alike."""
    for function in functions.values():
        function()
    times: dict[str, list[float]] = {name: [] for name in functions}
    for _ in range(repeats):
        for name, function in functions.items():
            start = time.perf_counter()
            function()
            times[name].append(time.perf_counter() - start)
    return {name: sorted(values)[len(values) // 2] for name, values in times.items()}


def measure(repeats: int = 5) -> dict[str, float]:
    """Seconds of prediction and of fitting, each with its bare counterpart (float64, the same shapes)."""
    import numpy as np
    from scipy.linalg import cholesky, solve_triangular

    from baselines.objects import GPIS, Sphere, SquaredExponential

    rng = np.random.default_rng(0)

    def sphere(count: int) -> tuple[np.ndarray, np.ndarray]:
        normals = rng.standard_normal((count, 3))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return 0.1 * normals, normals

    kernel = SquaredExponential(LENGTH_SCALE)
    model = GPIS(kernel, Sphere(0.09), NOISE, NORMAL_NOISE).fit(*sphere(QUERY_POINTS))
    x = rng.uniform(-0.15, 0.15, (QUERIES, 3))
    n = 4 * QUERY_POINTS
    products, weights = rng.standard_normal((4 * QUERIES, n)), rng.standard_normal(n)
    lower = np.asfortranarray(np.tril(rng.standard_normal((n, n))) + n * np.eye(n))
    cross = np.asfortranarray(rng.standard_normal((n, QUERIES)))
    predict = medians(
        {
            "mean and gradient": lambda: model.predict(x, gradient=True),
            "bare product": lambda: products @ weights,
            "with variance": lambda: model.predict(x, gradient=True, variance=True),
            "bare product and solve": lambda: (
                products @ weights,
                solve_triangular(lower, cross, lower=True, check_finite=False),
            ),
        },
        repeats,
    )
    points, normals = sphere(FIT_POINTS)
    large = GPIS(kernel, Sphere(0.09), NOISE, NORMAL_NOISE)
    gram = kernel.gram(points, True)
    gram[np.diag_indices_from(gram)] += NORMAL_NOISE**2
    return predict | medians(
        {"fit": lambda: large.fit(points, normals), "bare Cholesky": lambda: cholesky(gram, lower=True)},
        max(repeats // 2, 3),
    )


def peer(python: str, repeats: int = 3) -> dict[str, Any]:
    """GPyTorch's gradient kernel on the same task as "mean and gradient", run by another interpreter.

    Raises:
        OSError: the interpreter cannot be run, or has no GPyTorch.
    """
    arguments = json.dumps([QUERY_POINTS, QUERIES, repeats, LENGTH_SCALE, NOISE])
    done = subprocess.run(
        [python, "-c", PEER_SCRIPT, arguments], capture_output=True, text=True, env=os.environ | single_thread()
    )
    for line in done.stdout.splitlines():
        if line.startswith("ANSWER "):
            answer: dict[str, Any] = json.loads(line.removeprefix("ANSWER "))
            return answer
    said = done.stderr.strip().splitlines()
    raise OSError(f"the peer's interpreter ended with status {done.returncode}: {said[-1] if said else ''}")


def single_thread() -> dict[str, str]:
    """Environment variables of one BLAS thread."""
    return dict.fromkeys(THREADS, "1")


def main(argv: list[str]) -> int:
    """Print seconds and ratios."""
    parser = argparse.ArgumentParser(prog="python -m agents.gpis_speed", description=__doc__)
    parser.add_argument("--peer-python", metavar="PYTHON", help="an interpreter with gpytorch")
    parser.add_argument("--repeats", type=int, default=5)
    args = parser.parse_args(argv)
    if any(os.environ.get(name) != "1" for name in THREADS):  # BLAS reads them as it is loaded: start over
        command = [sys.executable, "-m", "agents.gpis_speed", *argv]
        return subprocess.run(command, env=os.environ | single_thread()).returncode
    seconds = measure(args.repeats)
    for name, bare in (
        ("mean and gradient", "bare product"),
        ("with variance", "bare product and solve"),
        ("fit", "bare Cholesky"),
    ):
        ratio = seconds[name] / seconds[bare]
        print(f"{name:18} {1e3 * seconds[name]:8.1f} ms   {bare:22} {1e3 * seconds[bare]:8.1f} ms   ratio {ratio:.2f}")
    if args.peer_python:
        try:
            found = peer(args.peer_python)
        except OSError as error:
            print(f"--peer-python: {error}", file=sys.stderr)
            return 1
        ratio = found["seconds"] / seconds["mean and gradient"]
        versions = ", torch ".join(found["versions"])
        print(f"GPyTorch {versions}, RBFKernelGrad: {1e3 * found['seconds']:.0f} ms, {ratio:.0f} times as long")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
