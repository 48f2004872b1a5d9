"""Torque of the air on the tilted, spinning rotor: one interface, four models.

========== ===================================================== =====================================
model      what it is                                            says nothing of
========== ===================================================== =====================================
correlation published drag of discs and cylinders                the transverse torques
vorticity  end-gap vorticity for the restoring torque, drag as   the torque across the tilt
           above
table      computed torques, interpolated                        tilts and speeds outside of the table
surrogate  power laws fitted to a table                          the same
========== ===================================================== =====================================
"""
