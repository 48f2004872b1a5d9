# %% [markdown]
# # Fit chosen parameters
#
# What a user of lmfit or iminuit does on the first day: choose what is free, give a prior, look at the covariance, the
# intervals, a profile and the correlations. More: [fit chosen parameters](../fit.md).

# %%
import pandas as pd

import gyrowheel as gw

pd.options.display.precision = 3
quick = gw.simulate("quick", effects={"windage": {}}, machine=6)  # or your recording
model = gw.Model("gyrowheel").add("windage", fit=quick)

# %% [markdown]
# Free are both coefficients of the drag of the air, and the friction of the bearing; the exponent has a wide prior of
# our own.

# %%
fit = model.fit(
    quick,
    free=["windage", "bearing_viscous"],
    priors={"windage.n": (1.5, 0.2)},
    bounds={"windage.n": (1.0, 2.0)},
)
print(fit)

# %% [markdown]
# Every parameter has value, error, prior, and what the data say without the prior, in SI units: a data frame of pandas,
# or `fit.params["windage.n"].value`.

# %%
table = fit.to_frame().query("free")
print(table[["parameter", "value", "standard_error", "data_value", "data_error"]])

# %%
print(fit.covariance.to_frame())

# %% [markdown]
# Intervals that follow χ², which may be asymmetric:

# %%
for name, (low, high) in fit.conf_interval(level=0.95).items():
    print(f"{name}: {low:.4g} .. {high:.4g}")

# %% [markdown]
# The profile of one parameter, the region of two, and all correlations:

# %%
fit.plot("windage.n")

# %%
fit.plot("windage.w", "windage.n")

# %%
fit.plot()

# %% [markdown]
# Is a fit without the friction as good? The natural log of the Bayes factor decides; above 5 is strong.

# %%
fixed = model.fit(quick, free="windage", priors={"windage.n": (1.5, 0.2)})
print(f"evidence for the free friction: {fit.evidence(fixed):.1f}")
