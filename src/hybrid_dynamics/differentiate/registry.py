"""Differentiators by name."""

from __future__ import annotations

METHODS: tuple[str, ...] = ("butterworth",)
