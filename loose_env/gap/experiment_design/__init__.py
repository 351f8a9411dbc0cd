"""Choice of motions: experiments that tell candidate effects of an arm apart.

Data flow: servo_arm -> motions -> library -> candidates -> bank -> next_motion.
"""
