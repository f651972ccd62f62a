// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace satsurf::app {

// The files of app/report/, which CMake puts into the program.
extern const char* const kReportHtml;    ///< the page, with {{slots}}
extern const char* const kReportCss;     ///< its looks
extern const char* const kReportScript;  ///< what turns the surface

}  // namespace satsurf::app
