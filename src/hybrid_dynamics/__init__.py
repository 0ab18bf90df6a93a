"""Interpretable hybrid robot dynamics: torque = rigid body + residual, and the physical effect behind the residual."""
