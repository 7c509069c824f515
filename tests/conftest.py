"""How hypothesis draws: the same examples every time, or, to search for others, any and many more.

A test that draws takes its count of examples as a share of ``settings.default.max_examples``, so that every profile
scales it. What a search finds becomes an example of its own in the file of the law.
"""

from hypothesis import settings

settings.register_profile("fixed", max_examples=100, deadline=None, derandomize=True, database=None)
settings.register_profile("many", settings.get_profile("fixed"), max_examples=400)
settings.register_profile("search", max_examples=1000, deadline=None, derandomize=False, print_blob=True)
settings.load_profile("fixed")
