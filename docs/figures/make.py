"""The review's sixteen figures for the site: their pictures and numbers, kept beside this file."""

import json
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

from PIL import Image  # noqa: E402

import granjax as gx  # noqa: E402

HERE = Path(__file__).parent

if __name__ == "__main__":
    table = {}
    for made in gx.reproduce.one_by_one(None, HERE, True, gx.plots):
        print(made)
        Image.open(made.picture).convert("RGB").save(HERE / f"{made.label}.webp", quality=80, method=6)
        made.data.unlink()
        made.picture.unlink()
        table[made.label] = {"number": made.number, "seconds": round(made.seconds, 1)}
    (HERE / "made.json").write_text(json.dumps(table, indent=1) + "\n")
