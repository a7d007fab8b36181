"""What is missing from a model: triage, locate, screen, refit, decide, next test."""
