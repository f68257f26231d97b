"""Plan the next measurement: which readings to take, from where, and which uncertainty they will give.

Manual: `twin doc plan`.
"""

# Stages of planning; each takes the result of the one before (`plan`; `separate` differs in the model and the last stage).
#
#     task         Task             machine, kit, time budget, and what to minimise
#     candidates   Candidates       every possible reading: poses with clearance, reflectors visible from each station
#     model        PlanModel        derivatives of the readings with respect to the unknowns (aims: criteria to minimise)
#     fill         FilledPlan       stations and readings: design chooses them, route orders them and adds up the time
#     forecast     Forecast         predicted uncertainties
#     result       Plan             the plan as displayed and written
#
# A measuring sequence: `sequences` (poses, reach, prediction), `measure` (SequencePlan), `programs` (for a control).
# A check of a written correction: `confirmation` (ConfirmationPlan, with a Plan or a SequencePlan).
# A thermal test: `drift` (schedules; DriftPlan).

from twin.planning.confirmation import plan_confirmation
from twin.planning.design import duration
from twin.planning.kit import Kit
from twin.planning.measure import SequencePlan, judge_sequence, measuring_sequence
from twin.planning.plan import Forecast, Plan, Separation, judge, plan
from twin.planning.separate import separate
from twin.planning.sequences.specification import InstrumentSizes

__all__ = [
    "Forecast",
    "InstrumentSizes",
    "Kit",
    "Plan",
    "Separation",
    "SequencePlan",
    "duration",
    "judge",
    "judge_sequence",
    "measuring_sequence",
    "plan",
    "plan_confirmation",
    "separate",
]
