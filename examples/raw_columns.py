# %% [markdown]
# # Raw columns
#
# A recording consists of numpy columns in SI units. Read them, compute with them, plot them, and export them to other
# programs.

# %%
import numpy as np

import gyrowheel as gw

gw.simulate("check", folder="check")  # or your recording
recording = gw.Recording.open("check")
print(recording)

# %%
print(", ".join(recording.to_columns()))
tilt = np.hypot(recording.measurement["tilt_x"], recording.measurement["tilt_y"])
print(f"largest tilt: {np.degrees(tilt.max()):.2f}° at {recording.time[tilt.argmax()]:.2f} s")

# %%
recording.plot()

# %% [markdown]
# As a table, with the units in its metadata:

# %%
names = gw.write_table(recording, "check.parquet")
print(f"{len(names)} columns, the last ones {', '.join(names[-2:])}")
