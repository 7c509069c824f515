from pathlib import Path

import numpy as np
import pytest
import yaml

from palletloc.geometry import LevelPose, level_pose

BODIES = {
    "forklift": {"V1": [-0.9, 0.45, 2.1], "V2": [-0.9, -0.45, 2.08], "V3": [0.55, -0.4, 1.2]},
    "A": {"A-LL": [0.0, 0.55, 0.012], "A-LR": [0.0, -0.55, 0.012], "A-UL": [0.0, 0.55, 0.132]},
    "B": {"B-LL": [0.0, 0.55, 0.012], "B-LR": [0.0, -0.55, 0.012], "B-UR": [0.0, -0.55, 0.132]},
}
STOPS = {"S1": LevelPose(410.0, 187.0, 11.6, 0.62), "S2": LevelPose(411.5, 188.1, 11.6, 0.66)}
PALLETS = {"A": LevelPose(413.0, 191.0, 11.6, 2.17), "B": LevelPose(414.3, 192.6, 13.15, 2.2)}


@pytest.fixture
def lab_points() -> dict[str, list[float]]:
    """Return the places of all targets of a small site, without any error."""
    points: dict[str, list[float]] = {}
    for stop, pose in STOPS.items():
        places = {f"{name}-{stop}": place for name, place in BODIES["forklift"].items()}
        points |= {name: pose.transform().apply(place).tolist() for name, place in places.items()}
    for pallet, pose in PALLETS.items():
        points |= {name: pose.transform().apply(place).tolist() for name, place in BODIES[pallet].items()}
    return points


@pytest.fixture
def lab(tmp_path: Path, lab_points: dict[str, list[float]]) -> Path:
    """Return a recording with nothing but a survey, as a table with tenths of millimetres."""
    truth = tmp_path / "lab" / "truth"
    truth.mkdir(parents=True)
    rows = [f"{name},{x:.4f},{y:.4f},{z:.4f}" for name, (x, y, z) in lab_points.items()]
    (truth / "survey.csv").write_text("\n".join(["name,x_m,y_m,z_m", *rows]) + "\n")
    stops = [{"name": name, "time_s": 1.0 + 2 * number} for number, name in enumerate(STOPS)]
    plan = {"file": "survey.csv", "sigma_m": 0.0006, "stops": stops, "bodies": BODIES}
    (truth / "survey.yaml").write_text(yaml.safe_dump(plan, sort_keys=False))
    return truth.parent


@pytest.fixture
def lab_truth() -> dict[tuple[str, str], LevelPose]:
    """Return ``forklift_from_pallet`` of each stop and pallet of that site."""
    return {
        (stop, pallet): level_pose(STOPS[stop].transform().inv() * PALLETS[pallet].transform())
        for stop in STOPS
        for pallet in PALLETS
    }


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)
