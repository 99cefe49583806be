"""Albedo images: registration, statistics of posterior samples, scores."""
