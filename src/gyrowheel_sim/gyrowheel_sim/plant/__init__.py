"""The simulated machine.

`machine` holds it (parameters, state, noise) and steps it; `kernel` is its compiled step, `state` the layout of its
arrays, `compose` puts the compiled module together; `scenario` describes the true machine; `guard` and `pacing`
serve `node`, the ROS node.
"""
