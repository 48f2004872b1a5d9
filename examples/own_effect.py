# %% [markdown]
# # Your own effect
#
# Write it as a formula, put it into a simulated machine, and fit it. Grammar of formulas:
# [your effects](../formulas.md).

# %%
import gyrowheel as gw

# a drag that grows with the square of the spin rate; r is the spin rate divided by the reference rate of the bench
brake = gw.own_effect("axial_torque = -k*r^2; k = 0.001 [N*m]", name="brake")
recording = gw.simulate("check", effects=[brake])

# %% [markdown]
# Without the effect the model fails in the torque about the spin axis; with it, no channel fails:

# %%
model = gw.Model().add(brake, fit=recording)
for title, own in (("without", gw.Model()), ("with", model)):
    print(f"{title:8} worst channel: χ²/N {gw.compare(recording, own).worst:.1f}")

# %% [markdown]
# The estimate; the true value is 0.001 N·m:

# %%
value, error = model.effects["brake"]["k"], model.effect_errors["brake"]["k"]
print(f"k = {value:.5f} ± {error:.5f} N·m")
