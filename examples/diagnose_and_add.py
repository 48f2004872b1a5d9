"""Find the effect that a model lacks, add it, and watch the error fall on a recording that was not fitted."""

import gyrowheel as gw

# A machine whose parameters differ from the bench file, with one effect that the model does not have.
quick = gw.simulate("quick", effects={"aero_cross": {}}, machine=6)
check = gw.simulate("check", effects={"aero_cross": {}}, machine=6)

model = gw.Model("gyrowheel")
found = gw.diagnose(quick, model, validate=check)
print(found)

better = model.add(found, fit=quick, validate=check)
print(better.added)

better.plot().savefig("error.png")
better.save("wheel.yaml")
print("picture: error.png, model: wheel.yaml")
