"""The reproduction of the one paper: its claims and their judge, the ablations, its figures and its page."""
