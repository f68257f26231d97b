"""Tool path of a program: conversion between words and axis commands, and the motions between blocks."""

from twin.compensation.toolpath.follow import Follower, follow, motionless
from twin.compensation.toolpath.frames import FrameSpaces
from twin.compensation.toolpath.increments import INCREMENTS, increments_hinted, numbers_of_increments
from twin.compensation.toolpath.motions import LostBlock, MotionColumns, Passage, PathMotion, ToolPath, by_reason
from twin.compensation.toolpath.samples import CHORD_MM, SAMPLES_A_PIECE, spacings
from twin.compensation.toolpath.sections import Section, SectionMotions, motions_of, sections, spaces
from twin.compensation.toolpath.words import Setup, WordSpace, axis_words, check_domains, outside_range, turns_tool

__all__ = [
    "CHORD_MM",
    "INCREMENTS",
    "SAMPLES_A_PIECE",
    "Follower",
    "FrameSpaces",
    "LostBlock",
    "MotionColumns",
    "Passage",
    "PathMotion",
    "Section",
    "SectionMotions",
    "Setup",
    "ToolPath",
    "WordSpace",
    "axis_words",
    "by_reason",
    "check_domains",
    "follow",
    "increments_hinted",
    "motionless",
    "motions_of",
    "numbers_of_increments",
    "outside_range",
    "sections",
    "spaces",
    "spacings",
    "turns_tool",
]
