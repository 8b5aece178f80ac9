"""Kinds of evidence for and against a closure, one module each: how it is measured, its log odds, its sentence."""
