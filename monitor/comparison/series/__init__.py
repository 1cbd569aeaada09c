"""More than two epochs: regions that keep their identity, their rates, and how each goes on."""
