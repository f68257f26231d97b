"""Candidate causes of a misfit: every effect of machine, instrument and calibration, as columns of signatures.

Candidates of the machine come from the effects' specifications (`twin.model.effects`); those of the instrument and mistakes in the
calibration are specified here, one module for each. To add one, write its module and add it to
`twin.diagnosis.candidates.catalogue.SOURCES`.
"""
