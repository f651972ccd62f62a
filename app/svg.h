// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>

namespace satsurf::app {

// Pieces of SVG and HTML that figures are put together from. Places and sizes are in px.

/// Text with the marks of HTML and SVG made harmless, in attributes too.
std::string escaped(const std::string& text);

/// The same text, or HTML, with numbers kept on one line with their units.
std::string unbroken(const std::string& text);

/// One line of text.
/// anchor  start, middle or end of it lies at x
/// more    further attributes
std::string text_at(double x, double y, const char* anchor, const std::string& text,
                    const std::string& more = {});
/// A straight line.
/// more  further attributes
std::string line(double x0, double y0, double x1, double y1, const char* colour, double width,
                 const std::string& more = {});
/// A filled rectangle.
std::string box(double x, double y, double width, double height, const char* colour);

/// A drawing of its own that is as wide as there is room.
/// label  for those who do not see it
std::string chart(double width, double height, const std::string& label,
                  const std::string& content);
/// A figure with its title and what it shows, which are HTML.
std::string captioned(const std::string& title, const std::string& about,
                      const std::string& content);

/// A step of 1, 2 or 5 times a power of ten that cuts [0, high] into four to ten.
double tick_step(double high);
/// A length of 1, 2 or 5 times a power of ten, a fifth to a half of `most`.
double round_length(double most);
/// A length in m or, from a thousand on, in km.
std::string length_text(double metres);

}  // namespace satsurf::app
