"""Volumetric compensation inside the control: kinematics with errors, executed by the control in every cycle."""
