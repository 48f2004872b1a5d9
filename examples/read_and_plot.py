"""Read a recording as columns, plot it, and write it as a table that other programs read."""

import sys

import numpy as np

import gyrowheel as gw

if len(sys.argv) == 1:
    gw.simulate("check", folder="check")
recording = gw.Recording.open(sys.argv[1] if len(sys.argv) > 1 else "check")
print(recording)

tilt = np.hypot(recording.measurement["tilt_x"], recording.measurement["tilt_y"])
print(f"largest tilt: {np.degrees(tilt.max()):.2f} deg at {recording.time[tilt.argmax()]:.2f} s")

recording.plot().savefig("recording.png")
gw.write_table(recording, "recording.parquet")
print("picture: recording.png, table: recording.parquet")
