"""Views that a lens was not fitted to: what the fit is worth elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calibration.lenses.adjustment import adjust
from calibration.lenses.bundle import Bundle, Rig
from calibration.lenses.fit import LensFit

_FEWEST_SHOTS, _EVERY = 8, 4


def hold_out_rms(fit: LensFit) -> float:
    """Return the root mean square distance in pixels over every fourth shot, with lenses fitted to the others.

    Parameters
    ----------
    fit : LensFit
        Its outliers stay left out.

    Returns
    -------
    float
        NaN where there are fewer than 8 shots.
    """
    shots = sorted({view.shot for view, used in zip(fit.bundle.views, fit.used, strict=True) if used.any()})
    if len(shots) < _FEWEST_SHOTS:
        return float("nan")
    held = set(shots[_EVERY - 1 :: _EVERY])
    rest = _part(fit, [shot for shot in shots if shot not in held])
    fitted = adjust(*rest)
    bundle, rig = _part(fit, sorted(held))
    rig = replace(rig, values=fitted.values, lenses=fitted.lenses, boards=fitted.boards)
    rig = adjust(bundle, rig, np.zeros(len(bundle.names()), dtype=np.bool_))
    sigma = np.concatenate([view.sigma for view in bundle.views])
    residuals = bundle.predict(rig).residuals * sigma[:, None]
    return float(np.sqrt((residuals**2).sum(-1).mean()))


def _part(fit: LensFit, shots: list[int]) -> tuple[Bundle, Rig]:
    """Return the observations of some shots, and the rig with their poses."""
    views = tuple(
        replace(view.kept(used), shot=shots.index(view.shot))
        for view, used in zip(fit.bundle.views, fit.used, strict=True)
        if view.shot in shots and used.any()
    )
    return replace(fit.bundle, views=views), replace(fit.rig, shots=fit.rig.shots[shots])
