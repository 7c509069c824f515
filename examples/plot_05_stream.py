"""
Pallets over an approach
========================

Follow the pallets while odometry and shots arrive: the loop that runs on a vehicle, here fed by a recording.
"""

# %%
# A source yields odometry and shots in the order of their arrival. The localizer measures single shots; the tracker
# fuses what it finds with the odometry, and tells what became of every input.

from importlib.resources import files
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from palletloc import Localizer, read_recording
from tracking import PalletTracker, RecordingSource, ShelfLocalizer, smoothed, stream

recording = read_recording(Path(str(files("palletloc") / "sample")))
localizer = ShelfLocalizer(Localizer(recording.models), recording.camera, recording.mounting, recording.shelf)
tracker = PalletTracker(models=recording.models, keep_history=True)
for event in stream(RecordingSource(recording), localizer, tracker):
    if event.track is not None:
        print(f"{event.time:.2f} s: track {event.track} {event.kind}")

# %%
# The tracker answers at any time, also between shots and a little ahead of the odometry. Each answer says how it is
# known.

for time in (5.9, 6.4, 6.6):
    for state in tracker.tracks(time):
        pose, sigma = state.pose, np.sqrt(np.diag(state.covariance))
        print(
            f"{time} s: track {state.track}, {state.knowledge}: x {pose.x:.3f} m ({1e3 * sigma[0]:.1f} mm), "
            f"yaw {np.degrees(pose.yaw):.2f} deg ({np.degrees(sigma[3]):.2f} deg)"
        )

# %%
# At the end, a smoother goes back over the whole approach: each pose by the shots before and after it. The filter's
# standard deviations fall from shot to shot; the smoother's are small from the first one on.

shots = {shot.time for shot in recording.shots}
later = [state for moment in smoothed(tracker.history()) for state in moment.states if state.time in shots]
figure, axes = plt.subplots(figsize=(9, 4), layout="constrained")
for number in sorted({state.number for state in later}):
    steps = [state for state in later if state.number == number]
    times = [state.time for state in steps]
    filtered = np.degrees([np.sqrt(state.track.covariance[3, 3]) for state in steps])
    (line,) = axes.plot(times, filtered, "o-", label=f"track {number}: filter")
    smooth = np.degrees([np.sqrt(state.covariance[3, 3]) for state in steps])
    axes.plot(times, smooth, "s--", color=line.get_color(), label=f"track {number}: smoother")
axes.set(xlabel="time of the shot / s", ylabel="standard deviation of the yaw / deg", yscale="log")
axes.legend()
plt.show()
