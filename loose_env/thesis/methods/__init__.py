"""Methods that only the thesis uses.

Data flow: looseness -> motion.
"""
