"""Processes that run whole episodes of Gymnasium environments; they import no JAX."""
