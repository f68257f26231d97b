"""The next measurement worth making."""

from twin.planning.forecast import Forecast
from twin.planning.kit import Kit
from twin.planning.plan import judge, plan
from twin.planning.result import Plan, Separation
from twin.planning.route import duration
from twin.planning.separate import separate

__all__ = ["Forecast", "Kit", "Plan", "Separation", "duration", "judge", "plan", "separate"]
