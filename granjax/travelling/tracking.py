"""The place and the speed of a wave in a run, by a fit of its exact shape in every frame."""

from typing import NamedTuple

import numpy as np

from ..flow import Run, simulate
from ..lattice import Lattice, State
from .solitary import Wave, solitary_wave

# The most Gauss-Newton iterations.
ITERATIONS = 12
# The step in contacts, over the square root of the number of contacts, at which they stop.
STILL = 1e-13
# The strain, over the peak, at which the window of a fit ends.
WINDOW = 1e-3
# The residual, over the peak, above which the fit is not a solitary wave.
MISFIT = 0.02
# The relative difference below which two speeds share a shape; a wave that far away gives slopes.
NEAR = 1e-5
# How often the shape is updated at most.
ROUNDS = 3


class Track(NamedTuple):
    """The places of a wave in some frames, and the straight line through them.

    `wave`: the exact wave of about its speed. `coarse`: places in a run of twice the step.
    `misfit`: the largest residual of the fit in any frame, over the peak.
    """

    wave: Wave
    times: np.ndarray
    places: np.ndarray
    coarse: np.ndarray
    misfit: float

    @property
    def speed(self) -> float:
        """The slope of the line through the places."""
        return _line(self.times, self.places)[1]

    @property
    def speed_error(self) -> float:
        """The largest change of the slope with either half of the frames or twice the step."""
        return max(abs(_line(*other)[1] - self.speed) for other in self._others())

    def at(self, time: float) -> tuple[float, float]:
        """Return the line's place at a time, and its largest distance from the other lines."""
        place = _at(time, self.times, self.places)
        return place, max(abs(_at(time, *other) - place) for other in self._others())

    def passes(self, place: float) -> tuple[float, float]:
        """Return the time at which the line passes a place, and its error."""
        time = self.times.mean() + (place - self.places.mean()) / self.speed
        return time, self.at(time)[1] / abs(self.speed)

    def _others(self):
        half = (len(self.times) + 1) // 2
        parts = slice(half), slice(len(self.times) - half, None)
        return [
            *((self.times[part], self.places[part]) for part in parts),
            (self.times, self.coarse),
        ]


def run_twice(lattice: Lattice, state: State, time: float, frames: int, step: float) -> list[Run]:
    """Run with a step, of which two fit between two frames, and with twice that step."""
    step = min(step, time / (2 * (frames - 1)))
    return [simulate(lattice, state, time, step=h, save_at=frames) for h in (step, 2 * step)]


def reach_of(wave: Wave, share: float) -> float:
    """Return the place beyond which the strain is below a share of the peak."""
    x = 1.0
    peak = abs(float(wave.amplitude))
    while abs(float(wave.strain(x))) > share * peak:
        x *= 1.1
    return x


def tracked(
    wave: Wave, times: np.ndarray, strains: np.ndarray, coarse: np.ndarray, guesses: np.ndarray
) -> Track:
    """Follow a wave through strains (T, contacts) of two runs, from guesses of its places."""
    places, misfit = fitted(wave, strains, guesses)
    return Track(wave, times, places, fitted(wave, coarse, places)[0], misfit)


class Leaving(NamedTuple):
    """A wave after a collision or reflection: track, and amplitude and energy with errors.

    `why`: the reason why it is not a solitary wave; empty where it is one.
    """

    track: Track
    amplitude: np.ndarray
    energy: np.ndarray
    why: str


def leaving(
    wave: Wave, times: np.ndarray, strains: np.ndarray, coarse: np.ndarray, guesses: np.ndarray
) -> Leaving:
    """Fit the exact wave of its own speed to a wave that is followed as by `tracked`."""
    track = tracked(wave, times, strains, coarse, guesses)
    none = np.full(2, np.nan)
    if track.misfit < 1:
        try:
            track, beside = _of_own_speed(track, strains, coarse)
        except ValueError as error:
            return Leaving(track, none, none, f"is no solitary wave: {error}")
    if not track.misfit < MISFIT:
        why = f"differs from a solitary wave by {track.misfit:.1%} of its peak: other waves are still about it"
        return Leaving(track, none, none, why)
    return Leaving(track, *(_number(track, beside, name) for name in ("amplitude", "energy")), "")


def _of_own_speed(track, strains, coarse):
    """Return the track with the exact wave of its speed, and a nearby wave for slopes.

    **Raises** ValueError where the law has no such wave.
    """
    for _ in range(ROUNDS):
        wave = track.wave
        speed = track.speed
        own = float(wave.speed)
        side = "compression" if float(wave.amplitude) > 0 else "tension"
        close = abs(speed / own - 1) < NEAR
        beside = solitary_wave(
            wave.law, speed=own * (1 + NEAR) if close else speed, mass=wave.mass, side=side
        )
        if close:
            return track, beside
        track = tracked(beside, track.times, strains, coarse, track.places)
        if abs(track.speed / float(beside.speed) - 1) < NEAR and abs(speed / own - 1) < 0.01:
            return track, wave
    return track, wave


def _number(track, beside, name):
    at = float(getattr(track.wave, name))
    speed = float(track.wave.speed)
    slope = (float(getattr(beside, name)) - at) / (float(beside.speed) - speed)
    rounding = np.finfo(float).eps * abs(at) * 8
    error = abs(slope) * track.speed_error + rounding
    return np.array([at + slope * (track.speed - speed), error])


def fitted(wave: Wave, strains: np.ndarray, guesses: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the places (T,) of the best fits, and the largest residual over the peak.

    Places count contacts. The window moves with the wave, so that an even residual shifts no place.
    """
    contacts = strains.shape[1]
    peak = float(wave.amplitude)
    half = int(np.ceil(reach_of(wave, WINDOW))) + 1
    window = np.arange(-half, half + 1)
    rows = np.arange(len(strains))[:, None]
    places = np.array(guesses, float)
    with np.errstate(all="ignore"):
        for _ in range(ITERATIONS):
            middle = np.clip(np.nan_to_num(np.rint(places)), half, contacts - 1 - half).astype(int)
            n = middle[:, None] + window
            xi = n - places[:, None]
            # d strain/d xi = -(v_n - v_{n+1})/c
            velocities = np.asarray(wave.velocity(np.stack([xi, xi + 1])))
            slope = -(velocities[0] - velocities[1]) / float(wave.speed)
            rest = strains[rows, n] - np.asarray(wave.strain(xi))
            move = -(rest * slope).sum(1) / (slope**2).sum(1)
            places = places + np.clip(move, -1, 1)
            if np.abs(move).max() < STILL * contacts**0.5:
                break
    return places, np.max(np.abs(rest)) / abs(peak)


def _line(times, places):
    t = times - times.mean()
    return places.mean(), t @ places / (t @ t)


def _at(time, times, places):
    mean, slope = _line(times, places)
    return mean + slope * (time - times.mean())
