"""The controllers: the moving sequence, Algorithm 1, HTMPC, several starts, and estimation."""

from psmpc_cli.control.controller import Controller
from psmpc_cli.control.interface import Command, State

__all__ = ["Command", "Controller", "State"]
