"""Figures of runs, studies, tasks and robots, and films of runs: `psmpc_cli.figures.registry` draws them."""
