"""What the stations of an epoch saw: whether beams went through a place, met it or were hidden from it, how steeply."""
