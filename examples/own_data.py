# %% [markdown]
# # Your own data
#
# A logger of another program uses other column names, other units and another sample rate. This one writes CSV at
# 1 kHz, and labels degrees as radians.

# %%
import numpy as np

import gyrowheel as gw

wheel = gw.simulate("check", effects={"windage": {}}, machine=6).measurement[::2]
columns = {
    "Time [s]": (wheel["stamp_ns"] - wheel["stamp_ns"][0]) * 1e-9,
    "Tilt X [deg]": np.degrees(wheel["tilt_x"]),
    "Tilt Y [rad]": np.degrees(wheel["tilt_y"]),
    "Encoder [turn]": wheel["spin_angle"] / (2 * np.pi),
    "Speed [rpm]": wheel["spin_rate"] * 30 / np.pi,
    "Coil X [mV]": 1e3 * wheel["coil_voltage_x"],
    "Coil Y [mV]": 1e3 * wheel["coil_voltage_y"],
    "Motor voltage [V]": wheel["motor_voltage"],
    "Motor current [mA]": 1e3 * wheel["motor_current"],
}
table = np.column_stack(list(columns.values()))
np.savetxt("bench3.csv", table, fmt="%.9g", delimiter=",", header=",".join(columns), comments="")

# %% [markdown]
# Suggest a column map: by names, units and ranges, and by tests against the physics of the wheel. A map with open
# questions is never used silently:

# %%
found = gw.suggest_map("bench3.csv")
print(found)

# %% [markdown]
# Answer the question, and read the table by the corrected map:

# %%
given = found.content
given["columns"]["tilt_y"]["unit"] = "deg"
recording = gw.read_table("bench3.csv", given)
recording.plot()

# %% [markdown]
# It is now a recording like any other.

# %%
print(gw.diagnose(recording, gw.Model("gyrowheel")))
