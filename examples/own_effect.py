"""Write an effect of your own as a formula, put it into a simulated machine, and fit it to the recording."""

import gyrowheel as gw

# A drag that grows with the square of the spin rate r, in units of the bench's reference rate (see docs/formulas.md).
brake = gw.own_effect("axial_torque = -k*r^2; k = 0.001 [N*m]", name="brake")

recording = gw.simulate("check", effects=[brake])
before = gw.compare(recording, gw.Model())
model = gw.Model().add(brake, fit=recording)
after = gw.compare(recording, model)

print(f"worst channel: chi2/N {before.worst:.1f} without the effect, {after.worst:.1f} with it")
value, error = model.effects["brake"]["k"], model.effect_errors["brake"]["k"]
print(f"k = {value:.5f} +- {error:.5f} N*m")
model.save("brake.yaml")
