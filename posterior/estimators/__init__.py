"""Estimators: single answers, to compare with and to start from."""

from .hio import Retrieved, hio
