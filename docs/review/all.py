"""The review's sixteen figures: `python docs/review/all.py` stores their pictures and numbers here.

`--check` only compares the numbers. If one differs, the exit code is 1.
"""

import json
import sys
import time
from importlib import import_module
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

import granjax as gx  # noqa: E402

HERE = Path(__file__).parent
FIGURES = (
    *("fig1_2", "fig1_3", "fig1_4", "fig1_5", "fig2_2", "fig2_3", "fig2_4", "fig2_5"),
    *("breather_1", "breather_2", "breather_3", "dsw_1", "dsw_2", "dsw_3", "dsw_4", "dsw_5"),
)

if __name__ == "__main__":
    made = {}
    for name in FIGURES:
        start = time.perf_counter()
        with gx.plots.style():
            rows = import_module(name).make()
            if "--check" not in sys.argv:
                plt.savefig(HERE / f"{name}.webp", dpi=150, pil_kwargs={"quality": 80, "method": 6})
        plt.close("all")
        for row, (value, expected, within) in rows.items():
            verdict = "agrees" if abs(value - expected) <= within else "DIFFERS"
            print(f"{name}  {row}: {value:.12g}, {expected:.12g} +- {within:g}: {verdict}")
            made[name] = made.get(name, []) + [[row, float(value), expected, within, verdict]]
        print(f"{name}  {time.perf_counter() - start:.1f} s", flush=True)
    if "--check" not in sys.argv:
        (HERE / "made.json").write_text(json.dumps(made, indent=1) + "\n")
    sys.exit(any(row[-1] == "DIFFERS" for rows in made.values() for row in rows))
