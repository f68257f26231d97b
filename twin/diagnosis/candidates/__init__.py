"""What could be wrong: every effect of the machine, of the instrument and of the calibration, as columns of the readings.

Candidates of the machine come from the effects' specifications (`twin.machine.effects`); those of the instrument and mistakes in the
calibration are specified here, one file a cause. To add one: its file, and its line in `twin.diagnosis.candidates.catalogue.SOURCES`.
"""
