"""Measuring sequences for instruments that measure the tool relative to the table: touch probe, R-test, ball bar.

A sequence gives rotary positions, parts on the table and offsets; `reach` computes the linear axes from the nominal kinematics and
drops the points that are out of reach.
"""
