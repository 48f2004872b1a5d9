"""The simulated machine.

`machine` contains it (parameters, state, noise) and advances it by samples; `kernel` is its compiled step, `state`
the layout of its arrays, `compiled` the source of the compiled module; `scenario` describes the true machine;
`protection` and `real_time` serve `node`, the ROS node.
"""
