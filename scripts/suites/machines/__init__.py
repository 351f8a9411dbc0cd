"""Blind suite of `loose diagnose` on machines unlike the package's models.

Random serial arms with what real machines have and a nominal model lacks: joint friction, sampled
servos, flexible joints and links, a base that gives, cables, imperfect sensors. The machine is
plain MuJoCo with its own sampled control; `arms`, `disturbances`, `machine`, `plans`,
`recorder` and `case` import nothing of loose_env. Run it as

    python -m scripts.suites.machines --cases 100 --out FILE.jsonl

Data flow: arms -> disturbances -> machine -> plans -> recorder -> case -> run -> grade.
"""
