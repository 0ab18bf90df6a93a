"""Simulation of robot arms: multi-sine references, PID, zero-order-hold rollouts in lockstep, planted effects."""

from hybrid_dynamics.simulation.controller import Controller, ControllerSettings, effective_inertia, make_controller
from hybrid_dynamics.simulation.dataset import as_trajectory, simulate_dataset
from hybrid_dynamics.simulation.effects import (
    JointEffects,
    coulomb,
    dahl,
    from_state_torque,
    load_dependent,
    offset,
    stribeck,
    viscous,
)
from hybrid_dynamics.simulation.references import Reference, ReferenceSettings, multi_sine, reference_from_positions
from hybrid_dynamics.simulation.rollout import Refusal, Rollout, SimulationSettings, simulate
from hybrid_dynamics.simulation.sensors import SensorSettings, record, true_run
from hybrid_dynamics.simulation.twin import DriveFriction, Recording, simulate_recordings, simulate_twin, with_armature

__all__ = [
    "Controller",
    "ControllerSettings",
    "DriveFriction",
    "JointEffects",
    "Recording",
    "Reference",
    "ReferenceSettings",
    "Refusal",
    "Rollout",
    "SensorSettings",
    "SimulationSettings",
    "as_trajectory",
    "coulomb",
    "dahl",
    "effective_inertia",
    "from_state_torque",
    "load_dependent",
    "make_controller",
    "multi_sine",
    "offset",
    "record",
    "reference_from_positions",
    "simulate",
    "simulate_dataset",
    "simulate_recordings",
    "simulate_twin",
    "stribeck",
    "true_run",
    "viscous",
    "with_armature",
]
