"""Kinds of evidence for and against a closure, a module each: measurement, log odds, sentence."""
