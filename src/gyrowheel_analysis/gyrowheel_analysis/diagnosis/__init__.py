"""Diagnosis of a model: selection of effects, events, unknown forms, proof, design of the next test."""
