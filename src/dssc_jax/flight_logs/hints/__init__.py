"""Where a log disagrees with a study: signals in another unit, sign, axis, clock or start."""
