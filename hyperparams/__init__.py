"""Hyper-parameters as YAML, one file per algorithm; `paper/` holds the paper's Tables 1 and 2.

This module exists because an editable install cannot import the folder without it.
"""
