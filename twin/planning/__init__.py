"""The next measurement worth making."""

from twin.planning.forecast import Forecast
from twin.planning.kit import Kit
from twin.planning.plan import judge, plan
from twin.planning.result import Plan

__all__ = ["Forecast", "Kit", "Plan", "judge", "plan"]
