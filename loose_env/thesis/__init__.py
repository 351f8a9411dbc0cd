"""The thesis's rigs, methods and tables, run here and set beside what it printed."""
