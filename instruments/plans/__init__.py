"""The measurement plans: what to do with lamp, door and camera, step by step. `steps.py` says how to read one."""

from __future__ import annotations

from typing import Any

from phoslab import plan_parameters
from phoslab.instruments.plans.check import check
from phoslab.instruments.plans.decay import decay
from phoslab.instruments.plans.emission import emission
from phoslab.instruments.plans.excitation import excitation
from phoslab.instruments.plans.flats import flats
from phoslab.instruments.plans.lamp import lamp
from phoslab.instruments.plans.lvf import lvf
from phoslab.instruments.plans.steps import Plan, Setup

PLANS: dict[str, Any] = {
    "flats": flats,
    "lamp": lamp,
    "lvf": lvf,
    "emission": emission,
    "decay": decay,
    "excitation": excitation,
    "check": check,
}


def start(parameters: plan_parameters.Parameters, setup: Setup) -> Plan:
    """Begin the plan that `parameters` are of."""
    (name,) = (n for n, kind in plan_parameters.PLANS.items() if kind is type(parameters))
    plan: Plan = PLANS[name](parameters, setup)
    return plan
