"""Every method against every kind of aliasing: problems, methods, trials, their rows and what is drawn from them."""
