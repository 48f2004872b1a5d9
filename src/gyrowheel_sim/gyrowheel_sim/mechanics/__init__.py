"""Equations of motion of the rotor on its flex gimbal: kinematics, derivation, dynamics, inverse dynamics."""
