"""Compensation of programs, from blocks to blocks."""
