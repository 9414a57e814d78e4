"""The doctor: what is odd about an installation, a robot folder or a measurement log.

It refuses nothing that other commands accept and repairs nothing: it looks at everything at once and says in sentences
what will matter later, and what to do about it. What cannot be read at all ends as it does everywhere, with one line.
"""
