"""The elements of an HTML page."""

from html.parser import HTMLParser

VOID = ("meta", "img", "br")


class Element:
    def __init__(self, tag, attributes):
        self.tag, self.text, self.attributes = tag, "", attributes

    def __getitem__(self, name):
        return self.attributes.get(name)


class Elements(HTMLParser):
    """Every element of a page, in order, with the text inside it; they must close in order."""

    def __init__(self, text):
        super().__init__()
        self.found, self.open = [], []
        self.feed(text)
        assert not self.open
        self.text = self.found[0].text

    def handle_starttag(self, tag, attrs):
        element = Element(tag, dict(attrs))
        self.found.append(element)
        if tag not in VOID:
            self.open.append(element)

    def handle_endtag(self, tag):
        assert self.open.pop().tag == tag

    def handle_data(self, data):
        for element in self.open:
            element.text += data

    def of(self, *tags):
        return [element for element in self.found if element.tag in tags]

    def named(self, name):
        return [element for element in self.found if element["id"] == name]
