"""What do granjax's XLA flags do to other JAX code in the same process? `python benchmarks/flags.py [--quick]`

Writes flags.json and flags.png beside this file. Each task runs in processes of its own that take turns, with the flags
that `import granjax` sets and without, all cores free, float32 as JAX's users have it. `ratio` is the time with the
flags over that without: below 1 they help, above 1 they cost.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from speed import circumstances

HERE = Path(__file__).parent
ROUNDS = 5


def _matrix(n, seed=0):
    import jax

    return jax.random.normal(jax.random.key(seed), (n, n))


def matmul():
    """A product of two 1000 x 1000 matrices."""
    a = _matrix(1000)
    return lambda a: a @ a, (a,)


def solve():
    """LAPACK's solution of 500 equations."""
    import jax.numpy as jnp

    return jnp.linalg.solve, (_matrix(500), _matrix(500, 1)[0])


def fft():
    """A Fourier transform of 2^20 numbers."""
    import jax.numpy as jnp

    return jnp.fft.fft, (jnp.arange(2.0**20) % 7,)


def elementwise():
    """exp(sin x) + x^2 summed over 1e7 numbers."""
    import jax.numpy as jnp

    return lambda x: jnp.sum(jnp.exp(jnp.sin(x)) + x * x), (jnp.linspace(0.0, 9.0, 10_000_000),)


def training():
    """A gradient step of a network 256-512-512-10 on 1024 samples."""
    import jax
    import jax.numpy as jnp

    sizes = (256, 512, 512, 10)
    weights = [
        jax.random.normal(jax.random.key(i), s) / 16 for i, s in enumerate(zip(sizes, sizes[1:]))
    ]
    x = jax.random.normal(jax.random.key(9), (1024, 256))

    def loss(weights):
        y = x
        for w in weights:
            y = jnp.tanh(y @ w)
        return jnp.mean(y**2)

    return lambda w: jax.tree.map(lambda a, g: a - 0.1 * g, w, jax.grad(loss)(w)), (weights,)


def loop_of_products():
    """A loop of 20 products of 500 x 500 matrices."""
    import jax

    return lambda a: jax.lax.fori_loop(0, 20, lambda _, b: (a @ b) / 30.0, a), (_matrix(500),)


def recurrent():
    """A recurrent network of 64 neurons over 1000 times, batch of 32."""
    import jax
    import jax.numpy as jnp

    w = _matrix(64) / 8
    x = jax.random.normal(jax.random.key(3), (1000, 32, 64))
    return lambda x: jax.lax.scan(lambda h, x: (jnp.tanh(h @ w + x), None), jnp.zeros((32, 64)), x)[
        0
    ], (x,)


def small_loop():
    """A loop of 1e5 scalar steps."""
    import jax
    import jax.numpy as jnp

    return lambda x: jax.lax.fori_loop(0, 100_000, lambda _, x: x + 1e-3 * jnp.cos(x), x), (
        jnp.float32(0.3),
    )


def wide_loop():
    """A loop of 50 elementwise steps on 1e6 numbers."""
    import jax
    import jax.numpy as jnp

    x = jnp.linspace(0.0, 1.0, 1_000_000)
    return lambda x: jax.lax.fori_loop(0, 50, lambda _, x: x + 1e-3 * jnp.cos(x), x), (x,)


TASKS = (
    matmul,
    solve,
    fft,
    elementwise,
    training,
    loop_of_products,
    recurrent,
    small_loop,
    wide_loop,
)


def child(name):
    """Median seconds of a task in this process."""
    if os.environ["TASK_FLAGS"] == "1":
        os.environ["JAX_ENABLE_X64"] = "0"
        import granjax  # noqa: F401 - its import sets the flags
    import jax

    task = {task.__name__: task for task in TASKS}[name]
    function, arguments = task()
    function = jax.jit(function)
    jax.block_until_ready(function(*arguments))
    times = []
    until = time.perf_counter() + 1.0
    while time.perf_counter() < until or len(times) < 3:
        start = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def measured(task, rounds):
    """Seconds with and without the flags, and the ratio, round by round."""
    seconds = {"1": [], "0": []}
    for _ in range(rounds):
        for flags in seconds:
            environment = {
                **os.environ,
                "TASK_FLAGS": flags,
                "PYTHONPATH": f"{HERE.parent}{os.pathsep}{HERE}",
            }
            environment.pop("XLA_FLAGS", None)
            command = [sys.executable, __file__, "--child", task.__name__]
            done = subprocess.run(
                command, env=environment, capture_output=True, text=True, check=True
            )
            seconds[flags].append(float(done.stdout.splitlines()[-1]))
    ratios = np.divide(seconds["1"], seconds["0"])
    return {
        "name": task.__name__,
        "task": task.__doc__,
        "ratio": float(np.median(ratios)),
        "lowest": float(ratios.min()),
        "highest": float(ratios.max()),
        "seconds": {
            "with flags": float(np.median(seconds["1"])),
            "without": float(np.median(seconds["0"])),
        },
    }


def chart(rows, path):
    """Bars of the ratios."""
    from granjax.plots import COLOURS, figure, save, style

    with style():
        made = figure(6.4, 3.4)
        axes = made.subplots()
        places = np.arange(len(rows))[::-1]
        axes.barh(places, [row["ratio"] for row in rows], 0.6, color=COLOURS[0])
        for place, row in zip(places, rows):
            axes.plot([row["lowest"], row["highest"]], [place, place], color="black", lw=1)
            axes.text(
                max(row["ratio"], row["highest"]) + 0.03,
                place,
                f"{row['ratio']:.2f}",
                va="center",
                fontsize=9,
            )
        axes.axvline(1, color="black", lw=0.8, ls=":")
        axes.set_yticks(places, [row["task"].rstrip(".") for row in rows], fontsize=8)
        axes.set_xlabel("time with the flags over time without")
        axes.set_xlim(0, 1.2 * max(max(row["highest"] for row in rows), 1))
        save(made, path)


def main():
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--quick", action="store_true", help="one round of one task; writes nothing"
    )
    parser.add_argument("--child", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.child:
        print(child(options.child))
        return
    rows = [
        measured(task, 1 if options.quick else ROUNDS)
        for task in (TASKS[:1] if options.quick else TASKS)
    ]
    for row in rows:
        print(f"{row['ratio']:6.2f}  ({row['lowest']:.2f} ... {row['highest']:.2f})  {row['task']}")
    if not options.quick:
        result = {**circumstances(), "rounds": ROUNDS, "tasks": rows}
        (HERE / "flags.json").write_text(json.dumps(result, indent=1) + "\n")
        chart(rows, HERE / "flags.png")


if __name__ == "__main__":
    main()
