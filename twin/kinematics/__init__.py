"""Kinematics: tool pose from commands with and without errors, Newton step, inverse kinematics, rotary solutions of a tool vector."""
