"""Robots as Pinocchio sees them, always through a plain URDF."""

from hybrid_dynamics.robots.robot import RigidBodyTorques, Robot
from hybrid_dynamics.robots.urdf import find_description, lock_joints, movable_joints

__all__ = ["RigidBodyTorques", "Robot", "find_description", "lock_joints", "movable_joints"]
