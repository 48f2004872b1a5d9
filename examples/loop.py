# %% [markdown]
# # The loop in ten lines
#
# A machine has something that the model does not know. Where does the model fail, what is missing, and does the error
# fall when it is added?

# %%
import gyrowheel as gw

# recordings of your own: gw.Recording.open("runs/monday")
quick = gw.simulate("quick", effects={"aero_cross": {}}, machine=6)
check = gw.simulate("check", effects={"aero_cross": {}}, machine=6)
model = gw.Model("gyrowheel")

# %% [markdown]
# Where does it fail? χ²/N is 1 where nothing but noise is left.

# %%
print(gw.compare(quick, model))

# %% [markdown]
# What is missing? The second recording is only predicted, never fitted: it is the proof.

# %%
found = gw.diagnose(quick, model, validate=check)
print(found)

# %% [markdown]
# Add it. `model` stays as it was; `better` is a new one, and `better.save("wheel.yaml")` keeps it.

# %%
better = model.add(found, fit=quick, validate=check)
print(better.added)

# %% [markdown]
# The error falls to the noise, also on the recording that was not used:

# %%
better.plot()
