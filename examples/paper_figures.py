# %% [markdown]
# # Figures of the published test
#
# The paper (Huo et al. 2016) held tilts at 3500 rpm and compared the DC voltages of coils and motor with the torques
# of the air. Here the same plan runs on a bench with the computed torques of the air. Statement by statement:
# [the published test](../paper.md), or `gw.paper()`.

# %% [markdown]
# The reachable angular momenta of the wheel (Figs 3 and 4):

# %%
import numpy as np

import gyrowheel as gw

gw.momentum().plot()

# %% [markdown]
# Voltages over the tilt, and their increments compared with the model with and without air (Figs 13 to 15):

# %%
tilts = gw.simulate("paper_tilt", effects={"aero:surrogate": {}}, folder="paper_tilt")
air = gw.Model().add("aero:surrogate", fit=tilts)
gw.drag(tilts, air).plot()

# %% [markdown]
# Actuator torque budget at a tilt of 3° over the speed, with the part of the air (Figs 16 and 17):

# %%
speeds = [rpm * np.pi / 30 for rpm in (1000, 2000, 3000, 4000)]
gw.torques(model=air, tilt=np.radians(3), spin_rate=speeds).plot()
