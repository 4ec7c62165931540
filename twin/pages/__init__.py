"""The pages: plain HTML, CSS and JavaScript, all from here."""
