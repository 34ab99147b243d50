"""Pulses in ordered networks of guides; run by hand: pytest benchmarks/long."""

import numpy as np
from test_plane import turned_tree

import granjax as gx
from granjax import scenes


def exponential(amplitude):
    """The slope of log(amplitude) over its number, with its standard error."""
    A = np.stack([np.ones(len(amplitude)), np.arange(len(amplitude))], -1)
    c = np.linalg.lstsq(A, np.log(amplitude), rcond=None)[0]
    left = np.log(amplitude) - A @ c
    return c[1], np.sqrt(np.linalg.inv(A.T @ A)[1, 1] * (left @ left) / (len(left) - 2))


def test_a_pulse_falls_exponentially_with_depth_in_an_ordered_network():
    beads = 12
    angle = 0.3

    def peaks(net, until):
        run = gx.simulate(
            net,
            gx.states.impact(net),
            until,
            step=0.1,
            record={"peak": gx.Peak(lambda t, y, _: y.v)},
        )
        return np.asarray(run.recorded["peak"]).reshape(-1, beads)[:, beads // 2]

    tree = peaks(scenes.network(*turned_tree(4, beads, angle), beads), 170.0)
    rate, error = exponential(tree[[2**level - 1 for level in range(1, 5)]])
    assert error < 1e-4 * abs(rate)
    # one junction gives the factor of every level, as the law has no scale
    single = peaks(scenes.junction(beads, (beads, beads), angles=(angle, -angle)), 45.0)
    assert abs(np.log(single[1] / single[0]) / rate - 1) < 0.01
    # a net of hexagons: guides split and join again
    stems = {}
    nodes = {}
    edges = []
    across = beads * np.sin(angle)
    down = beads * np.cos(angle)
    rows = 5
    for row in range(rows):
        for column in range(-row, row + 1, 2):
            y = -row * (beads + down)
            for end, at in (("top", y), ("bottom", y - beads)):
                nodes[f"{end} {row} {column}"] = (column * across, at)
            stems[row, column] = len(edges)
            edges.append((f"top {row} {column}", f"bottom {row} {column}"))
            if row + 1 < rows:
                edges += [
                    (f"bottom {row} {column}", f"top {row + 1} {column + side}") for side in (-1, 1)
                ]
    net = peaks(scenes.network(nodes, edges, beads), 330.0)
    rim = np.array([net[stems[row, row]] for row in range(1, rows)])
    middle = np.array(
        [max(net[stems[row, c]] for c in range(-row, row + 1, 2)) for row in range(rows)]
    )
    slope, error = exponential(rim)
    # along the rim, two turns a row: those of the tree, with error
    assert slope < -0.2 and error < 0.02 * abs(slope)
    assert (np.diff(middle) < 0).all() and middle[-1] < 0.5 * middle[0]
