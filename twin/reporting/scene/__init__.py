"""Animation of the machine running a program, as one self-contained HTML page. Only `draw` and `viewer` import meshcat.

Nothing is imported here: a report needs `field` and `viewer`, but neither the programs nor their compensation.
"""
