"""Print rules of a body: violations and their places, orientation, parting with keys.

``check.check_body`` is the one entry for any printed body.
"""
