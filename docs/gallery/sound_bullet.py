"""Sound bullets: five delays that meet at one site

Five sites at an edge of a square lattice are pushed, each with the delay that its distance asks for, so that all pulses
arrive at the focus together. In a linear lattice their heights add up.

:systems: sound bullets
:part: The plane
:number: height at the focus over the sum of what each channel gives alone
:expected: 1
:within: 0.0001
:source: superposition; Spadoni, Daraio, Proc. Natl. Acad. Sci. USA 107, 7230 (2010)
"""
import granjax as gx

square = gx.scenes.square(15, out_of_plane=True)
channels = [(0, j) for j in range(1, 14, 3)]
found = gx.studies.sound_bullet(square, channels, (7, 7), 18.0, force=0.7, duration=7.0)
number = float(found.gain[-1] / found.bound[-1])
ax = gx.plots.sound_bullet(found)
ax.figure.set_size_inches(5.4, 3.2)
