"""Do methods find what is there, and do their covariances tell the truth? A study over many synthetic scenes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rich.console import Console
from rich.progress import track

from benchmarks.consistency_tables import class_table, factor_table
from benchmarks.scenes import DrawnScene, draw_scene
from benchmarks.tables import Section
from benchmarks.views import ShotViews, expose, look, recorded
from palletloc.choices import Method
from palletloc.localizer import Localizer
from palletloc.synthetic.simulation import simulate


def measure_consistency(
    seeds: Sequence[int], methods: Sequence[Method], shots: int, width: int | None, console: Console
) -> list[Section]:
    """Localize every shot of many scenes and compare with the truth.

    Parameters
    ----------
    seeds : sequence of int
        One for each scene.
    methods : sequence of Method
        What to compare; all see the same images. The usual method if empty.
    shots : int
        Of each scene.
    width : int or None
        Width of all images in place of the drawn ones, in pixels.
    console : Console
        Shows progress.

    Returns
    -------
    list of Section
        For each method a table of its errors by height and resolution, and one of its covariances by what
        was drawn.
    """
    results: dict[Method, list[ShotViews]] = {}
    for seed in track(seeds, "scenes", console=console, transient=True, disable=not console.is_terminal):
        for method, seen in _through(draw_scene(seed, shots, width), methods):
            results.setdefault(method, []).append(seen)
    span = f"{len(seeds)} scenes from seed {seeds[0]} on, {shots} shots each"
    return [
        section
        for method, seen in results.items()
        for section in (class_table(method, seen, span), factor_table(method, seen))
    ]


def _through(scene: DrawnScene, methods: Sequence[Method]) -> Iterator[tuple[Method, ShotViews]]:
    """Return what each method makes of each shot of a scene; nothing is written."""
    simulation = simulate(scene.spec, scene.seed)
    models = recorded(simulation).models
    localizers = [Localizer(models, method) for method in methods] or [Localizer(models)]
    for index in range(scene.spec.shots):
        exposure = expose(scene, simulation, index)
        for localizer in localizers:
            try:
                yield localizer.method, look(exposure, localizer)
            except Exception as error:
                error.add_note(f"in shot {index} of the scene of seed {scene.seed}, with {localizer.method}")
                raise
