# %% [markdown]
# # The loop in ten lines
#
# A machine has an effect that the model lacks. Where does the model fail, what is missing, and does the error fall when
# the effect is added?

# %%
import gyrowheel as gw

# your recordings: gw.Recording.open("runs/monday")
quick = gw.simulate("quick", effects={"aero_cross": {}}, machine=6)
check = gw.simulate("check", effects={"aero_cross": {}}, machine=6)
model = gw.Model("gyrowheel")

# %% [markdown]
# Where does it fail? χ²/N is 1 if the residual is noise alone.

# %%
print(gw.compare(quick, model))

# %% [markdown]
# What is missing? The second recording is validation data: it is only predicted, never fitted.

# %%
found = gw.diagnose(quick, model, validate=check)
print(found)

# %% [markdown]
# Add it. `model` is unchanged; `better` is a new model, and `better.save("wheel.yaml")` saves it.

# %%
better = model.add(found, fit=quick, validate=check)
print(better.added)

# %% [markdown]
# The error falls to the noise floor, also on the validation data:

# %%
better.plot()
