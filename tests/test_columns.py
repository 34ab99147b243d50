"""Units of a file's columns: read from its header, said, or refused by the name of the argument that settles it."""

import numpy as np
import pytest
from scipy.io import savemat

import granjax as gx

TIMES = np.array([0.0, 1.0, 2.0, 3.5])


def written(folder, header, columns=1):
    rows = "\n".join(",".join([f"{t}"] + [f"{t + 0.5 * k}" for k in range(1, columns + 1)]) for t in TIMES)
    path = folder / "a.csv"
    path.write_text(f"{header}\n{rows}\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("header, options, size, value", [
    ("Time (us),Bead 3 [V]", {"gain": 0.125}, 1e-6, 0.125), ("Time (s),Bead 3 [mm/s]", {}, 1.0, 1e-3),
    ("t/ms,v/(mm/s)", {}, 1e-3, 1e-3), ("time_us,velocity_mm_s", {}, 1e-6, 1e-3), ("t [µs],v [m·s⁻¹]", {}, 1e-6, 1.0),
    ("Time,Ch 1", {}, 1.0, 1.0), ("Time [min],v", {}, 60.0, 1.0), ("Time (Seconds),v (filtered)", {}, 1.0, 1.0),
    ("time in ms,vel in um/s", {}, 1e-3, 1e-6), ("Time (msec),Bead V", {}, 1e-3, 1.0),
    ("x-axis,1\nsecond,Volt", {"gain": 2.0}, 1.0, 2.0), ("Time,Ch 1\n(ms),(mm/s)", {}, 1e-3, 1e-3),
    ("t,v", {"units": ("us", "mm/s")}, 1e-6, 1e-3), ("Time (ns),v", {"units": "us"}, 1e-6, 1.0),
    ("t,v", {"units": "mV", "gain": 2.0}, 1.0, 2e-3), ("t,v [mm/s]", {"gain": 1e-3}, 1.0, 1e-3),
    ("t,v [mV]", {"gain": 3.0, "units": "V"}, 1.0, 3.0), ("t (us),v [mm/s]", {"units": "SI"}, 1.0, 1.0),
    ("t,v [V]", {"gain": "sensitivity"}, 1.0, 1.0), ("time s,velocity mm/s", {}, 1.0, 1e-3),
    ("Time (s) [rel],Velocity [mm/s] (filtered)", {}, 1.0, 1e-3), ("t (ms),Speed [m/sec]", {}, 1e-3, 1.0),
    ("t,Bead (left)", {}, 1.0, 1.0), ("Frame,v", {"units": "ms"}, 1e-3, 1.0), ("t,v (counts)", {"gain": 0.5}, 1.0, 0.5),
    ("t,velocity_m_per_s", {}, 1.0, 1.0),
    ("Time.ms,v (millimeters per second)", {}, 1e-3, 1e-3), ("Time-ms,v {mm/s}", {}, 1e-3, 1e-3),
    ("Time <ms>,v mm s^-1", {}, 1e-3, 1e-3), ("ms since start,v [mm s^-1]", {}, 1e-3, 1e-3),
    ("ms,mm/s", {}, 1e-3, 1e-3), ("us,v (mm s^{-1})", {}, 1e-6, 1e-3), ("µs,v (m.s-1)", {}, 1e-6, 1.0),
    ("milliseconds since trigger,v (metres / second)", {}, 1e-3, 1.0), ("Time (ms,velocity_mm_per_s", {}, 1e-3, 1e-3),
    ("t,Sensor (1)", {}, 1.0, 1.0), ("t,Sensor (2)", {}, 1.0, 1.0), ("t,Vib 1 (OFV-505)", {}, 1.0, 1.0),
    ("t,Dev1/ai0", {}, 1.0, 1.0),
    ("time min,v", {}, 60.0, 1.0), ("t,vel (cm/sec)", {}, 1.0, 1e-2), ("t,Vib [top]", {}, 1.0, 1.0),
])
def test_columns_are_turned_into_si(tmp_path, header, options, size, value):
    traces = gx.Traces.from_csv(written(tmp_path, header), velocity=1, sites=3, **options)
    np.testing.assert_allclose(traces.times, size * TIMES, rtol=1e-14)
    np.testing.assert_allclose(traces.data[:, 0], value * (TIMES + 0.5), rtol=1e-14)


@pytest.mark.parametrize("header, options, message", [
    ("Time (samples),v", {}, r"time: expected a column in a unit of time \(s\), got 'Time \(samples\)'. Say units="),
    ("Time [V],v", {}, "time: .*unit of time"),
    ("t,v [mm]", {}, r"velocity: .*unit of velocity \(m/s\), got 'v \[mm\]'"),
    ("t,v (in/s)", {}, "velocity: .*'v .in/s.'"), ("t,v (counts)", {}, "velocity: .*unit of velocity"),
    ("Sample,v", {}, "time: .*got 'Sample'.* or sampling="),
    ("t,v [a.u.]", {}, "velocity: .*Say units= of it, such as 'm/s', 'mm/s'"),
    ("t,v [V]", {}, "gain: expected what leads"),
    ("t,v [mV]", {"gain": 0.1}, "gain: .*for 1 V or for 1 mV.*units='mV'"), ("T (MS),v", {}, "time: .*'T .MS.'"),
    ("t,v [mm/s]", {"gain": 0.1}, "gain: expected 0.001, for velocity is in mm/s.*units='mm/s'"),
    ("t,v", {"units": "kHz"}, "units: .*'kHz', which none of them takes"), ("t,v", {"units": "usec"}, "units: .*'us'"),
    ("TIME MS,v", {}, "time: .*'TIME MS'"),
    ("Min time,v", {}, "time: .*'Min time'"), ("t,VELOCITY MM/S", {}, "velocity: .*'VELOCITY MM/S'"),
    ("t,v (mph)", {}, "velocity: .*'v .mph.'"), ("t,velocity mph", {}, "velocity: .*'velocity mph'"),
    ("t,v (furlongs)", {}, "velocity: .*'v .furlongs.'"), ("t,v (in)", {}, "velocity: .*'v .in.'"),
    ("t,mV", {}, "gain: expected what leads from mV"), ("t,mm", {}, "velocity: .*got 'mm'"),
    ("t,v", {"units": "scaled"}, "units: .*traces are in SI"), ("t,v", {"units": ("s", "ms")}, "units: one|one word"),
])
def test_what_may_be_meant_in_two_ways_is_refused(tmp_path, header, options, message):
    with pytest.raises(ValueError, match=message):
        gx.Traces.from_csv(written(tmp_path, header), velocity=1, sites=3, **options)


@pytest.mark.parametrize("kind, header, size", [
    ("displacement", "u (millimeters)", 1e-3), ("displacement", "u (microns)", 1e-6), ("displacement", "um", 1e-6),
    ("force", "F (kilonewtons)", 1e3), ("force", "kN", 1e3), ("force", "F (lbs)", None), ("force", "F (pounds)", None),
    ("force", "F (dyn)", None), ("force", "force lbf", None), ("displacement", "u (inches)", None),
    ("displacement", "us", 1.0),
])
def test_lengths_and_forces_by_their_names(tmp_path, kind, header, size):
    where, path = {"contacts" if kind == "force" else "sites": 3}, written(tmp_path, f"t,{header}")
    if size is None:
        with pytest.raises(ValueError, match=f"{kind}: expected a column in a unit of {kind}"):
            gx.Traces.from_csv(path, **{kind: 1}, **where)
    else:
        data = gx.Traces.from_csv(path, **{kind: 1}, **where).data[:, 0]
        np.testing.assert_allclose(data, size * (TIMES + 0.5), rtol=1e-14)


def test_it_says_what_it_read(tmp_path):
    path = written(tmp_path, "Time (us),Bead 3 [mm/s],Bead 5", 2)
    traces = gx.Traces.from_csv(path, velocity=["Bead 3", 2], sites=[3, 5])
    assert traces.origin.units == "time in us (header), Bead 3 in mm/s (header), 2 in m/s (taken: nothing says)"
    np.testing.assert_allclose(traces.data[1], [1.5e-3, 2.0])
    said = repr(traces)
    assert "velocity of site 3, velocity of site 5" in said and "0 ... 3.5e-06 s" in said and "f64" not in said
    assert traces.origin.units in said


def test_names_of_variables_say_units_too(tmp_path):
    savemat(tmp_path / "a.mat", {"t_us": TIMES, "velocity_mm_s": TIMES + 1, "force_N": TIMES})
    traces = gx.Traces.from_mat(tmp_path / "a.mat", time="t_us", velocity="velocity_mm_s", sites=2)
    np.testing.assert_allclose(traces.times, 1e-6 * TIMES)
    np.testing.assert_allclose(traces.data[:, 0], 1e-3 * (TIMES + 1))
