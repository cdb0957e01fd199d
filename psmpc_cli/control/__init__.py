"""The controllers: the moving sequence, Algorithm 1, HTMPC, several starts, and estimation."""

from psmpc_cli.control.controller import Command, Controller, State

__all__ = ["Command", "Controller", "State"]
