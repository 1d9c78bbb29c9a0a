"""Estimators: single answers, to compare with and to start from."""
