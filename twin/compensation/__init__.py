"""Compensation: a program in, the program out that lands where the first one meant."""

from twin.compensation.bench import Options
from twin.compensation.compensator import Compensation, Compensator, compensate, compensate_file
from twin.compensation.report import Report

__all__ = ["Compensation", "Compensator", "Options", "Report", "compensate", "compensate_file"]
