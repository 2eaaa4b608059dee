"""The work on a recorded sequence, in order: identify, coarse cloud, judge, compensate, full cloud. Everybody runs
this."""
