"""Which vertices changed: patches of every size, tested with false discoveries held over the whole surface."""
