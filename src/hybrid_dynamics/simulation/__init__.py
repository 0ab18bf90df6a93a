"""Simulation of robot arms: multi-sine references, PID, zero-order-hold rollouts in lockstep, planted effects."""

from hybrid_dynamics.simulation.controller import Controller, ControllerSettings, effective_inertia, make_controller
from hybrid_dynamics.simulation.dataset import as_trajectory, simulate_dataset
from hybrid_dynamics.simulation.effects import JointEffects, coulomb, load_dependent, offset, stribeck, viscous
from hybrid_dynamics.simulation.references import Reference, ReferenceSettings, multi_sine, reference_from_positions
from hybrid_dynamics.simulation.rollout import Refusal, Rollout, SimulationSettings, simulate

__all__ = [
    "Controller",
    "ControllerSettings",
    "JointEffects",
    "Reference",
    "ReferenceSettings",
    "Refusal",
    "Rollout",
    "SimulationSettings",
    "as_trajectory",
    "coulomb",
    "effective_inertia",
    "load_dependent",
    "make_controller",
    "multi_sine",
    "offset",
    "reference_from_positions",
    "simulate",
    "simulate_dataset",
    "stribeck",
    "viscous",
]
