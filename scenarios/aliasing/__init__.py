"""Every method against every kind of aliasing: problems, methods, trials, rows, tables and figures."""
