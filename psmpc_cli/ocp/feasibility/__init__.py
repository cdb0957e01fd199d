"""What can be said of a task before it runs: what it cannot do, how it will go, and how it might go sooner."""
