"""Runs: folders that hold what was computed and executed, the journal of a learner, and the loop that feeds it."""
