"""Runs: folders with all that was computed and executed, the journal of a learner, and the loop that feeds it."""
