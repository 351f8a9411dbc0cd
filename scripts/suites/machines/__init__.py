"""Blind suite of diagnosis on machines unlike the package's models: `machine`, `case`, the command.

Random serial arms with what real machines have and a nominal model lacks: joint friction, sampled
servos, flexible joints and links, a base that gives, cables, imperfect sensors. `machine` and
`case` are plain MuJoCo with sampled control and import nothing of loose_env.
"""
