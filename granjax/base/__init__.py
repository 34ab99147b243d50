"""What everything stands on: checks of arguments, units, printing, files, compiled programs, XLA's flags."""
