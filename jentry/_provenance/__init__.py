"""What code is made of, and to whom it belongs.

- `modules`: whether a module belongs to jentry, Python, an installed package or the user.
- `parts`: what functions, classes and other objects are made of, and their digests.
- `program_keys`: the keys under which compiled programs are cached.

`campaign/users_code.py` digests the user's own code of a campaign by the same parts.
"""
