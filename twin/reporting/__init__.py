"""Report of the state of a machine on one HTML page: largest errors, their effect at the tool, actions, uncertainty, sources.

Manual: `twin doc report`. Nothing is imported here: the scene and the notebook need no report.
"""
