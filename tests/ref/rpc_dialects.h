// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "satsurf/rpc/model.h"

#include <array>
#include <cctype>
#include <iomanip>
#include <sstream>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

/// A camera in the words of every dialect that is read.
namespace satsurf::test::dialects {

inline std::string join(const std::array<double, 20>& c, const char* separator) {
  std::ostringstream out;
  out << std::setprecision(17);
  for (std::size_t i = 0; i < 20; ++i) out << (i ? separator : "") << c[i];
  return out.str();
}

struct Written {
  const char *text, *maxar, *rpcm;
  double value;
};
inline std::vector<Written> scalars(const rpc::Rpc& r) {
  return {{"LINE_OFF", "line Offset", "row_offset", r.line_off},
          {"SAMP_OFF", "samp Offset", "col_offset", r.samp_off},
          {"LAT_OFF", "lat Offset", "lat_offset", r.lat_off},
          {"LONG_OFF", "long Offset", "lon_offset", r.lon_off},
          {"HEIGHT_OFF", "height Offset", "alt_offset", r.height_off},
          {"LINE_SCALE", "line Scale", "row_scale", r.line_scale},
          {"SAMP_SCALE", "samp Scale", "col_scale", r.samp_scale},
          {"LAT_SCALE", "lat Scale", "lat_scale", r.lat_scale},
          {"LONG_SCALE", "long Scale", "lon_scale", r.lon_scale},
          {"HEIGHT_SCALE", "height Scale", "alt_scale", r.height_scale}};
}
struct WrittenList {
  const char *text, *maxar, *rpcm;
  const std::array<double, 20>& values;
};
inline std::vector<WrittenList> lists(const rpc::Rpc& r) {
  return {{"LINE_NUM_COEFF", "lineNumCoef", "row_num", r.line_num},
          {"LINE_DEN_COEFF", "lineDenCoef", "row_den", r.line_den},
          {"SAMP_NUM_COEFF", "sampNumCoef", "col_num", r.samp_num},
          {"SAMP_DEN_COEFF", "sampDenCoef", "col_den", r.samp_den}};
}
inline std::string without_blank(std::string s) {
  std::erase(s, ' ');
  return s;
}

inline std::string as_text(const rpc::Rpc& r) {
  std::ostringstream out;
  out << std::setprecision(17) << std::showpos;
  for (const auto& s : scalars(r)) out << s.text << ": " << s.value << " units\r\n";
  for (const auto& l : lists(r))
    for (std::size_t i = 0; i < 20; ++i)
      out << l.text << "_" << std::noshowpos << i + 1 << std::showpos << ": " << l.values[i]
          << "\r\n";
  return out.str();
}
inline std::string as_rpb(const rpc::Rpc& r) {
  std::ostringstream out;
  out << std::setprecision(17)
      << "satId = \"X\";\nbandId = \"P\";\nSpecId = \"RPC00B\";\nBEGIN_GROUP = IMAGE\n"
      << "\terrBias = 1;\n\terrRand = 0.1;\n";
  for (const auto& s : scalars(r))
    out << "\t" << without_blank(s.maxar) << " = " << s.value << ";\n";
  for (const auto& l : lists(r))
    out << "\t" << l.maxar << " = (\n\t\t\t" << join(l.values, ",\n\t\t\t") << ");\n";
  out << "END_GROUP = IMAGE\nEND;\n";
  return out.str();
}
inline std::string upper_of(std::string s) {
  for (char& c : s) c = static_cast<char>(std::toupper(c));
  return s;
}
inline std::string as_maxar_xml(const rpc::Rpc& r) {
  std::ostringstream out;
  out << std::setprecision(17)
      << "<?xml version=\"1.0\"?>\n<isd><IMD><IMAGE><MEANSUNEL>40.3</MEANSUNEL><MEANSUNAZ>162.1"
      << "</MEANSUNAZ><FIRSTLINETIME>2015-09-30T10:56:56Z</FIRSTLINETIME></IMAGE></"
         "IMD><RPB><IMAGE>";
  for (const auto& s : scalars(r)) {
    const std::string name = upper_of(without_blank(s.maxar));
    out << "<" << name << ">" << s.value << "</" << name << ">";
  }
  for (const auto& l : lists(r)) {
    const std::string name = upper_of(l.maxar);
    out << "<" << name << "List><" << name << ">" << join(l.values, " ") << "</" << name << "></"
        << name << "List>";
  }
  out << "</IMAGE></RPB></isd>\n";
  return out.str();
}
inline std::string as_dimap(const rpc::Rpc& r) {
  std::ostringstream out;
  out << std::setprecision(17)
      << "<?xml version=\"1.0\"?>\n<Dimap_Document><Rational_Function_Model><Global_RFM>"
      << "<Direct_Model><LINE_NUM_COEFF_1>77</LINE_NUM_COEFF_1></Direct_Model><Inverse_Model>";
  for (const auto& l : lists(r))
    for (std::size_t i = 0; i < 20; ++i)
      out << "<" << l.text << "_" << i + 1 << ">" << l.values[i] << "</" << l.text << "_" << i + 1
          << ">";
  out << "</Inverse_Model><RFM_Validity>";
  for (const auto& s : scalars(r)) {
    const bool pixel = std::string(s.text) == "LINE_OFF" || std::string(s.text) == "SAMP_OFF";
    out << "<" << s.text << ">" << s.value + (pixel ? 1 : 0) << "</" << s.text << ">";
  }
  out << "</RFM_Validity></Global_RFM></Rational_Function_Model></Dimap_Document>\n";
  return out.str();
}
/// 170 lines; the last 80 are the inverse polynomials, which must not be mistaken for the forward
/// ones.
inline std::string as_whu(const rpc::Rpc& r) {
  std::ostringstream out;
  out << std::setprecision(17);
  for (const auto& s : scalars(r)) out << s.text << ": " << s.value << " pixels\n";
  for (const auto& l : lists(r))
    for (std::size_t i = 0; i < 20; ++i)
      out << l.text << "_" << i + 1 << ": " << l.values[i] << "\n";
  for (const char* name : {"LAT_NUM", "LAT_DEN", "LONG_NUM", "LONG_DEN"})
    for (int i = 1; i <= 20; ++i) out << name << "_COEFF_" << i << ": " << 1000 + i << "\n";
  return out.str();
}
inline nlohmann::json as_rpcm(const rpc::Rpc& r) {
  nlohmann::json j;
  for (const auto& s : scalars(r)) j[s.rpcm] = s.value;
  for (const auto& l : lists(r)) j[l.rpcm] = l.values;
  return j;
}
inline nlohmann::json as_satnerf(const rpc::Rpc& r, const std::string& image, int width,
                                 int height) {
  return {{"img", image},       {"width", width},     {"height", height},
          {"min_alt", -27},     {"max_alt", "+30.5"}, {"sun_elevation", "+42.2"},
          {"sun_azimuth", 150}, {"rpc", as_rpcm(r)},  {"acquisition_date", "20150215161208"}};
}

}  // namespace satsurf::test::dialects
