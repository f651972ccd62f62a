// SPDX-License-Identifier: Apache-2.0
#include "satsurf/core/fields_json.h"
#include "satsurf/core/files.h"
#include "satsurf/rpc/camera_check.h"
#include "satsurf/rpc/gdal.h"
#include "satsurf/rpc/read.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <sstream>

#include <nlohmann/json.hpp>

namespace satsurf::rpc {
namespace {

using Items = std::map<std::string, std::string>;

struct Scalar {
  const char* key;    ///< GDAL, _RPC.TXT, DIMAP
  const char* maxar;  ///< RPB and Maxar XML, lower case
  const char* rpcm;   ///< Sat-NeRF JSON
  double Rpc::*member;
};
// In the order of the WHU-TLC file.
constexpr Scalar kScalars[] = {
    {"LINE_OFF", "lineoffset", "row_offset", &Rpc::line_off},
    {"SAMP_OFF", "sampoffset", "col_offset", &Rpc::samp_off},
    {"LAT_OFF", "latoffset", "lat_offset", &Rpc::lat_off},
    {"LONG_OFF", "longoffset", "lon_offset", &Rpc::lon_off},
    {"HEIGHT_OFF", "heightoffset", "alt_offset", &Rpc::height_off},
    {"LINE_SCALE", "linescale", "row_scale", &Rpc::line_scale},
    {"SAMP_SCALE", "sampscale", "col_scale", &Rpc::samp_scale},
    {"LAT_SCALE", "latscale", "lat_scale", &Rpc::lat_scale},
    {"LONG_SCALE", "longscale", "lon_scale", &Rpc::lon_scale},
    {"HEIGHT_SCALE", "heightscale", "alt_scale", &Rpc::height_scale},
};

struct Polynomial {
  const char* key;
  const char* maxar;
  const char* rpcm;
  std::array<double, 20> Rpc::*member;
};
constexpr Polynomial kPolynomials[] = {
    {"LINE_NUM_COEFF", "linenumcoef", "row_num", &Rpc::line_num},
    {"LINE_DEN_COEFF", "linedencoef", "row_den", &Rpc::line_den},
    {"SAMP_NUM_COEFF", "sampnumcoef", "col_num", &Rpc::samp_num},
    {"SAMP_DEN_COEFF", "sampdencoef", "col_den", &Rpc::samp_den},
};

std::string lower(std::string text) {
  for (char& c : text) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return text;
}
std::string upper(std::string text) {
  for (char& c : text) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
  return text;
}

/// throws  IoError for a number that no camera has
void check_scalar(const Scalar& s, double value, const std::string& where) {
  const std::string_view key = s.key;
  const bool scale = key.ends_with("SCALE"), lat = key.starts_with("LAT");
  const auto refuse = [&](const std::string& expected) {
    std::ostringstream text;
    text << where << ": " << s.key << " is " << value << ", expected " << expected;
    throw IoError(text.str());
  };
  if (scale && value == 0) refuse("another number");
  if (scale && value < 0 && !lat) refuse("a positive number");  // Planet counts latitudes down
  // degrees, the widest way longitudes are counted; m; px, of a crop far off in a long strip
  const double most = lat                         ? 90
                      : key.starts_with("LONG")   ? 360
                      : key.starts_with("HEIGHT") ? 1e6
                                                  : 1e9;
  if (!(std::abs(value) <= most))
    refuse("at most " + std::to_string(static_cast<long>(most)) + " either way");
  if (scale && std::abs(value) < 1e-9) refuse("at least 1e-9");
}

Rpc checked(const Rpc& rpc, const std::string& where) {
  check_camera(rpc, where);
  return rpc;
}

/// "KEY: value unit" lines; the parts of polynomials become one item, as GDAL has them.
Items items_of_lines(const std::string& text) {
  Items items;
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);)
    if (const auto cut = line.find_first_of(":="); cut != std::string::npos) {
      std::string key = upper(line.substr(0, cut));
      key.erase(
          std::remove_if(key.begin(), key.end(), [](unsigned char c) { return std::isspace(c); }),
          key.end());
      items[key] = line.substr(cut + 1);
    }
  return items;
}

/// KEY_1 ... KEY_20, each with an optional unit, put into one item KEY.
void gather_coefficients(Items& items, const std::string& where) {
  for (const Polynomial& p : kPolynomials) {
    std::string joined;
    for (int i = 1; i <= 20; ++i) {
      const std::string key = std::string(p.key) + "_" + std::to_string(i);
      const auto item = items.find(key);
      if (item == items.end()) throw IoError(where + ": key " + key + " is missing");
      std::istringstream words(item->second);
      std::string word;
      words >> word;
      joined += word + " ";
    }
    items[p.key] = joined;
  }
}

/// WHU-TLC: fixed order, line by line; names of the keys differ between releases.
Items items_of_whu(const std::vector<std::string>& lines, const std::string& where) {
  const auto value = [&](std::size_t i) {
    std::istringstream words(lines[i]);
    std::string key, word;
    if (!(words >> key >> word))
      throw IoError(where + ": line " + std::to_string(i + 1) + " is '" + lines[i] +
                    "', expected 'KEY: value'");
    return word;
  };
  Items items;
  std::size_t at = 0;
  for (const Scalar& s : kScalars) items[s.key] = value(at++);
  for (const Polynomial& p : kPolynomials)
    for (int i = 0; i < 20; ++i) items[p.key] += value(at++) + " ";
  return items;
}

/// `name = value;` and `name = (v, v, ...);`
Items items_of_rpb(const std::string& text) {
  std::map<std::string, std::string> all;
  for (std::size_t at = 0; at < text.size();) {
    const auto end = std::min(text.find(';', at), text.size());
    const std::string statement = text.substr(at, end - at);
    if (const auto cut = statement.rfind('='); cut != std::string::npos) {
      const auto last = statement.find_last_not_of(" \t\r\n", cut == 0 ? 0 : cut - 1);
      const auto first = statement.find_last_of(" \t\r\n", last);
      std::string value = statement.substr(cut + 1);
      for (char& c : value)
        if (c == '(' || c == ')' || c == ',' || c == '\n' || c == '\r') c = ' ';
      const std::size_t begin = first == std::string::npos ? 0 : first + 1;
      all[lower(statement.substr(begin, last + 1 - begin))] = value;
    }
    at = end + 1;
  }
  Items items;
  const auto take = [&](const char* key, const char* maxar) {
    if (const auto item = all.find(maxar); item != all.end()) items[key] = item->second;
  };
  for (const Scalar& s : kScalars) take(s.key, s.maxar);
  for (const Polynomial& p : kPolynomials) take(p.key, p.maxar);
  return items;
}

Items items_of_xml(const std::string& text, const std::string& where) {
  const GdalScope scope;
  const XmlPtr root(CPLParseXMLString(text.c_str()));
  if (!root) throw IoError(where + ": damaged XML; " + gdal_error());
  Items items;
  const auto take = [&](const std::string& key, const CPLXMLNode* node, const std::string& name) {
    if (const char* value = CPLGetXMLValue(node, name.c_str(), nullptr)) items[key] = value;
  };
  if (const CPLXMLNode* maxar = CPLSearchXMLNode(root.get(), "=RPB")) {
    for (const Scalar& s : kScalars) take(s.key, maxar, "IMAGE." + upper(s.maxar));
    for (const Polynomial& p : kPolynomials)
      take(p.key, maxar, "IMAGE." + upper(p.maxar) + "List." + upper(p.maxar));
    return items;
  }
  if (const CPLXMLNode* dimap = CPLSearchXMLNode(root.get(), "=Global_RFM")) {
    for (const Scalar& s : kScalars) take(s.key, dimap, std::string("RFM_Validity.") + s.key);
    for (const Polynomial& p : kPolynomials)
      for (int i = 1; i <= 20; ++i) {
        const std::string key = std::string(p.key) + "_" + std::to_string(i);
        take(key, dimap, "Inverse_Model." + key);
      }
    gather_coefficients(items, where);
    for (const char* key : {"LINE_OFF", "SAMP_OFF"})
      if (const auto value = parse_number(items[key])) {
        std::ostringstream shifted;  // DIMAP counts rows and columns from 1
        shifted.precision(17);
        shifted << *value - 1;
        items[key] = shifted.str();
      }
    return items;
  }
  const CPLXMLNode* gdal = CPLSearchXMLNode(root.get(), "=PAMDataset");
  for (const CPLXMLNode* list = gdal ? gdal->psChild : nullptr; list; list = list->psNext) {
    if (!EQUAL(list->pszValue, "Metadata") || !EQUAL(CPLGetXMLValue(list, "domain", ""), "RPC"))
      continue;
    for (const CPLXMLNode* item = list->psChild; item; item = item->psNext)
      if (EQUAL(item->pszValue, "MDI"))
        items[CPLGetXMLValue(item, "key", "")] = CPLGetXMLValue(item, nullptr, "");
    return items;
  }
  throw IoError(where +
                ": XML without a camera, expected an RPB (Maxar) or Global_RFM (DIMAP) "
                "element, or GDAL's metadata of the domain RPC");
}

using Json = nlohmann::json;

const Json& member(const Json& j, const std::string& key, const std::string& where) {
  const auto found = j.is_object() ? j.find(key) : j.end();
  if (!j.is_object() || found == j.end()) throw IoError(where + ": key \"" + key + "\" is missing");
  return *found;
}

double number(const Json& value, const std::string& key, const std::string& where) {
  std::optional<double> number;
  if (value.is_number()) number = value.get<double>();
  if (value.is_string()) number = parse_number(value.get_ref<const std::string&>());
  if (!number || !std::isfinite(*number))
    throw IoError(where + ": key \"" + key + "\" is " + value.dump().substr(0, 40) +
                  ", expected a number");
  return *number;
}

Rpc rpc_from_json(const Json& j, const std::string& where) {
  Rpc rpc;
  for (const Scalar& s : kScalars) rpc.*s.member = number(member(j, s.rpcm, where), s.rpcm, where);
  for (const Polynomial& p : kPolynomials) {
    const Json& list = member(j, p.rpcm, where);
    if (!list.is_array() || list.size() != 20)
      throw IoError(where + ": key \"" + p.rpcm + "\" is no list of 20 numbers");
    for (std::size_t i = 0; i < 20; ++i) (rpc.*p.member)[i] = number(list[i], p.rpcm, where);
  }
  return checked(rpc, where);
}

SatNerfJson satnerf_from_json(const Json& j, const std::string& where) {
  SatNerfJson out;
  const Json& image = member(j, "img", where);
  if (!image.is_string()) throw IoError(where + ": key \"img\" is no file name");
  out.image = image.get<std::string>();
  const auto extent = [&](const char* key) {
    const double v = number(member(j, key, where), key, where);
    if (!(v >= 1 && v <= 1e7) || v != std::floor(v))
      throw IoError(where + ": key \"" + key + "\" is " + member(j, key, where).dump() +
                    ", expected pixels");
    return static_cast<Index>(v);
  };
  out.width = extent("width");
  out.height = extent("height");
  out.rpc = rpc_from_json(member(j, "rpc", where), where);
  out.min_alt = number(member(j, "min_alt", where), "min_alt", where);
  out.max_alt = number(member(j, "max_alt", where), "max_alt", where);
  if (!(out.min_alt < out.max_alt))
    throw IoError(where + ": key \"min_alt\" is not below \"max_alt\"");
  if (!on_earth({out.min_alt, out.max_alt}))
    throw IoError(where + ": keys \"min_alt\" and \"max_alt\" are " +
                  member(j, "min_alt", where).dump() + " and " +
                  member(j, "max_alt", where).dump() + ", expected at most 1000 km either way");
  if (j.contains("sun_elevation"))
    out.sun_elevation_deg = number(j.at("sun_elevation"), "sun_elevation", where);
  if (j.contains("sun_azimuth"))
    out.sun_azimuth_deg = number(j.at("sun_azimuth"), "sun_azimuth", where);
  if (const auto date = j.find("acquisition_date"); date != j.end())
    out.acquisition_date = date->is_string() ? date->get<std::string>() : date->dump();
  return out;
}

}  // namespace

void check_camera(const Rpc& rpc, const std::string& where) {
  for (const Scalar& s : kScalars) check_scalar(s, rpc.*s.member, where);
  for (const Polynomial& p : kPolynomials) {
    const auto& c = rpc.*p.member;
    for (const double v : c)
      if (!std::isfinite(v))
        throw IoError(where + ": " + p.key + " holds " + std::to_string(v) +
                      ", expected finite numbers");
    if (std::all_of(c.begin(), c.end(), [](double v) { return v == 0; }))
      throw IoError(where + ": all of " + p.key + " are 0, expected a polynomial");
  }
}

Rpc rpc_from_gdal_metadata(const Items& items, const std::string& where) {
  Rpc rpc;
  const auto text = [&](const char* key) -> const std::string& {
    const auto item = items.find(key);
    if (item == items.end()) throw IoError(where + ": key " + key + " is missing");
    return item->second;
  };
  for (const Scalar& s : kScalars) {
    const auto value = parse_number(text(s.key));
    if (!value)
      throw IoError(where + ": " + s.key + " is '" + text(s.key) + "', expected a number");
    rpc.*s.member = *value;
  }
  for (const Polynomial& p : kPolynomials) {
    std::istringstream words(text(p.key));
    std::size_t count = 0;
    for (std::string word; words >> word; ++count) {
      const auto value = parse_number(word);
      if (!value) throw IoError(where + ": " + p.key + " holds '" + word + "', expected a number");
      if (count < 20) (rpc.*p.member)[count] = *value;
    }
    if (count != 20)
      throw IoError(where + ": " + p.key + " holds " + std::to_string(count) +
                    " numbers, expected 20");
  }
  return checked(rpc, where);
}

Rpc read_rpc_file(const std::filesystem::path& path) {
  const std::string where = path.string(), text = read_text_file(path, "a camera file");
  const auto first = text.find_first_not_of(" \t\r\n\xEF\xBB\xBF");
  if (first == std::string::npos) throw IoError(where + ": empty, expected a camera file");
  if (text[first] == '{') {
    const Json j = parse_json(text, where);
    return rpc_from_json(j.contains("rpc") ? j.at("rpc") : j, where);
  }
  if (text[first] == '<') return rpc_from_gdal_metadata(items_of_xml(text, where), where);
  if (lower(text).find("linenumcoef") != std::string::npos)
    return rpc_from_gdal_metadata(items_of_rpb(text), where);

  std::vector<std::string> lines;
  std::istringstream stream(text);
  for (std::string line; std::getline(stream, line);)
    if (line.find_first_not_of(" \t\r") != std::string::npos) lines.push_back(line);
  constexpr std::size_t kWhuLines = 170;  // 10 + 4 x 20 forwards + 4 x 20 backwards
  if (lines.size() == kWhuLines) return rpc_from_gdal_metadata(items_of_whu(lines, where), where);

  Items items = items_of_lines(text);
  if (!items.contains("LINE_OFF"))
    throw IoError(
        where +
        ": no camera in a known form, expected _RPC.TXT, RPB, Maxar or DIMAP XML, WHU-TLC or "
        "Sat-NeRF JSON");
  gather_coefficients(items, where);
  return rpc_from_gdal_metadata(items, where);
}

SatNerfJson read_satnerf_json(const std::filesystem::path& path) {
  const std::string where = path.string();
  return satnerf_from_json(parse_json(read_text_file(path, "a Sat-NeRF JSON"), where), where);
}

}  // namespace satsurf::rpc
