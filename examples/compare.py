"""Compare a model with a recording: how large the error is, where it sits, and a picture of it."""

import gyrowheel as gw

# A recording of your own: gw.Recording.open("runs/monday"). This one is simulated, with drag that the model lacks.
recording = gw.simulate("check", effects={"windage": {}}, machine=6)
model = gw.Model("gyrowheel")

result = gw.compare(recording, model)
print(result)
for name, channel in result.channels.items():
    print(f"{name:15} {channel.rms / channel.noise_floor_rms:5.2f} noise floors")

result.plot().savefig("compare.png")
print("picture: compare.png")
