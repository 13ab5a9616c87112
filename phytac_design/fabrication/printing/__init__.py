"""What a printer can make of a body: rules, violations and where, orientation, parting with keys.

``check.check_body`` is the one entry for any printed body.
"""
